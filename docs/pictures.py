"""Makes the pictures of this folder anew; needs Graphviz's `dot`.

`fig4.png` and `fig5.png` are those of the demo; `replay.png` is a screenshot of
the page that it writes.

python docs/pictures.py
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pydot

from limb_systems import Limb

FOLDER = Path(__file__).parent


def main() -> None:
    (graph,) = pydot.graph_from_dot_data(Limb().GetGraphvizString())
    graph.write_svg(FOLDER / "limb.svg")
    with tempfile.TemporaryDirectory() as out:
        subprocess.run([sys.executable, FOLDER.parent / "examples" / "demo.py", out], check=True)
        for name in ("fig4.png", "fig5.png"):
            shutil.copy(Path(out) / name, FOLDER / name)


if __name__ == "__main__":
    main()

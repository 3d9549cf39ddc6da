"""Makes the pictures of this folder anew; needs Graphviz's `dot`.

`replay.png` is a screenshot of the page that `make demo` writes.

python docs/pictures.py
"""

from pathlib import Path

import pydot

from hardware import LimbTwin, replay
from limb_systems import Limb, LimbParameters
from limb_systems.plots import plot_tracking, save_figure
from planners import plan, references

FOLDER = Path(__file__).parent


def main() -> None:
    (graph,) = pydot.graph_from_dot_data(Limb().GetGraphvizString())
    graph.write_svg(FOLDER / "limb.svg")
    trajectory = plan(LimbParameters(), references.step_and_decaying_sine())
    rollouts = [replay(trajectory, LimbTwin(seed=seed)) for seed in range(5)]
    title = "Steps and decaying sinusoid: plan, and five rollouts on an emulated limb"
    save_figure(plot_tracking(trajectory, rollouts, title), FOLDER / "fig5.png")


if __name__ == "__main__":
    main()

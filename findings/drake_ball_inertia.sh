#!/bin/sh
# Drake puts a ball of water in place of moments of inertia that rounding made inadmissible.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant


def moments(izz: str) -> np.ndarray:
    """Of a thin plate, whose third moment is the sum of the others, in text of ten digits."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(
        f"""<robot name="plate"><link name="plate"><inertial><mass value="0.001"/>
        <inertia ixx="2e-6" iyy="9e-6" izz="{izz}" ixy="0" ixz="0" iyz="0"/>
        </inertial></link></robot>""",
        "urdf",
    )
    inertia = plant.GetBodyByName("plate").default_rotational_inertia()
    return np.diag(inertia.CopyToFullMatrix3())


print("Drake", version("drake"))
print("guess:  an excess of 1e-9 of the sum is rounded off, or is an error")
exact, rounded = moments("1.1e-5"), moments("1.100000001e-5")
print("result:", exact, "becomes", rounded, "with a warning")
assert np.allclose(exact, [2e-6, 9e-6, 1.1e-5])
assert np.ptp(rounded) == 0.0
PY

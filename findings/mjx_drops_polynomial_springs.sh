#!/bin/sh
# pip pairs mujoco-mjx 3.17 with MuJoCo 4.0, whose polynomial springs MJX drops without a word.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check mujoco-mjx==3.17.0 mujoco==4.0.0
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

import mujoco
from mujoco import mjx

MODEL = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint axis="0 0 1" stiffness="{}"/>
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


def torques(stiffness: str) -> tuple[float, float]:
    """Of a spring that is turned by 1 rad, in MuJoCo and in MJX."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(stiffness))
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0
    in_mjx = mjx.forward(mjx.put_model(model), mjx.put_data(model, data))
    mujoco.mj_forward(model, data)
    return float(data.qfrc_passive[0]), float(in_mjx.qfrc_passive[0])


print("MuJoCo", mujoco.__version__, "MJX", version("mujoco-mjx"))
print("guess:  MJX refuses a model with a feature that it has not")
print("result: torques of a linear spring", torques("2"), "and of a cubic one", torques("2 0 30"))
assert torques("2") == (-2.0, -2.0)
assert torques("2 0 30") == (-32.0, -2.0)
PY

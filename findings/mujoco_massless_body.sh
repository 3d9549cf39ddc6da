#!/bin/sh
# MuJoCo places the inertial frame of a body without mass at twice its offset.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check mujoco-core==4.0.0
"$folder/bin/python" - <<'PY'
import mujoco
import numpy as np

MODEL = """<mujoco><worldbody><body name="base" pos="0.1 0 0">{inertial}<body pos="0 0.1 0">
<joint axis="0 0 1"/><geom size="0.01" mass="0.1" pos="0.05 0 0"/></body>
</body></worldbody></mujoco>"""
INERTIAL = '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>'

frames = []
for inertial in ("", INERTIAL):
    model = mujoco.MjModel.from_xml_string(MODEL.format(inertial=inertial))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    frames.append(data.xipos[1])
print("MuJoCo", mujoco.__version__)
print("guess:  the frame of a body without mass is the body's own, at 0.1 m")
print("result:", frames[0][0], "m; with an explicit inertial of no mass", frames[1][0], "m")
assert np.allclose([frame[0] for frame in frames], [0.2, 0.1])
PY

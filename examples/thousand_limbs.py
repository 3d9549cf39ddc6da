"""Simulate a thousand limbs in MuJoCo at once: the spread of the bend if wires heat differently."""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from mujoco import rollout

from limb_systems import LimbParameters, bend_angle
from urdf import limb_mjcf

STEP = 0.01  # s
DURATION = 20.0  # s
STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("-l", dest="limb", help="description of the limb (.yaml)")
parser.add_argument("-o", "--output", type=Path, default=Path("out"), help="folder")
parser.add_argument("-n", "--limbs", type=int, default=1000, help="number of limbs")
options = parser.parse_args()
limb = LimbParameters.of(options.limb)
model = mujoco.MjModel.from_xml_string(limb_mjcf(limb, timestep=STEP))
times = STEP * np.arange(round(DURATION / STEP))

# The last wire is on for half of the time; it heats by up to 10% more or less.
duty = np.zeros((options.limbs, len(times), model.nu))
heating = np.random.default_rng(0).uniform(0.36, 0.44, (options.limbs, 1))
duty[:, times < DURATION / 2, -1] = heating
state = np.zeros(mujoco.mj_stateSize(model, STATE))
data = mujoco.MjData(model)
mujoco.mj_getState(model, data, state, STATE)
states, _ = rollout.rollout(model, data, state, duty)

# The limbs' joints come first among the positions, which follow the time.
angles = states[:, ::10, 1 : 1 + limb.num_joints].reshape(-1, limb.num_joints)
bends = np.rad2deg(bend_angle(limb, angles.T)[0]).reshape(options.limbs, -1)
low, middle, high = np.quantile(bends, [0.025, 0.5, 0.975], axis=0)
times = times[::10]
plt.fill_between(times, low, high, alpha=0.3, label="95% of the limbs")
plt.plot(times, middle, label="median")
plt.xlabel("time, s")
plt.ylabel("bend, °")
plt.legend()
options.output.mkdir(parents=True, exist_ok=True)
plt.savefig(options.output / "thousand_limbs.png")
print(f"bends from {low.max():.1f}° to {high.max():.1f}° at most (95% of {options.limbs} limbs)")

"""Your own limb: describe it in a YAML file, and see how it bends and swings.

    python examples/own_limb.py [LIMB.yaml] [-o FOLDER]

A mistake in the file gives a sentence that names the field: try it with a misspelled
`stiffness`, or with 0 links, in a copy of own_limb.yaml.
"""

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np
from scipy.linalg import eigvalsh

from limb_systems import LimbError, LimbParameters, bend_angle, make_manipulator
from limb_systems.statics import static_equilibrium
from limb_systems.views.plots import Figure, save_figure


def main(options):
    # Compute the shapes: the sag as a cantilever, and each wire at its limit.
    limb = LimbParameters.load(options.limb)
    sagging, _ = static_equilibrium(dataclasses.replace(limb, gravity=[0.0, -9.81, 0.0]))
    shapes = {"sag as a cantilever": sagging}
    for index, name in enumerate(limb.wire_names):
        heated = np.full(len(limb.wires), limb.ambient_temperature)
        heated[index] = limb.temperature_limits.maximum
        shapes[f"{name} wire at {heated[index]:g} °C"], _ = static_equilibrium(limb, heated)

    # Print the bends, and draw the chain of links as complex numbers E1 + i E2.
    lengths = np.concatenate([np.full(s.links, s.length / s.links) for s in limb.segments])
    axis = Figure(layout="constrained").subplots()
    for label, angles in shapes.items():
        degrees = np.rad2deg(bend_angle(limb, angles))
        print(f"{label:<26}{', '.join(f'{angle:.1f}°' for angle in degrees)}")
        joints = 1000 * np.append(0, np.cumsum(lengths * np.exp(1j * np.cumsum(angles))))
        axis.plot(joints.real, joints.imag, "o-", markersize=4, label=label)
    axis.set(xlabel="E1, along the straight limb (mm)", ylabel="E2 (mm)", aspect="equal")
    axis.legend()
    save_figure(axis.figure, options.out / "own_limb.png")

    # Compute the frequency of the first mode from ω² M v = K v.
    rest, compliance = static_equilibrium(limb)
    plant = make_manipulator(limb)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, rest)
    squares = eigvalsh(np.linalg.inv(compliance), plant.CalcMassMatrix(context))  # ω²
    print(f"{'first mode':<26}{np.sqrt(squares[0]) / (2 * np.pi):.1f} Hz")
    print(f"{'written':<26}{options.out / 'own_limb.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Plot how a limb from a YAML file bends.")
    parser.add_argument("limb", nargs="?", default=Path(__file__).with_name("own_limb.yaml"))
    parser.add_argument("-o", "--out", type=Path, default="out", help="folder for the picture")
    try:
        main(parser.parse_args())
    except LimbError as error:
        sys.exit(f"error: {error}")

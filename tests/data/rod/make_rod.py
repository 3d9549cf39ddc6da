"""Makes sag.csv and ring_down.csv: a Cosserat rod that sags, and one that rings down.

Needs PyElastica, which is no dependency of the project; see README.md.

    python make_rod.py
"""

from pathlib import Path

import elastica as ea
import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

LENGTH, MASS, WIDTH, THICKNESS = 0.10, 0.025, 0.020, 0.010  # m, kg, m, m; the nominal limb's
GRAVITY = 9.81  # m/s²
SAG, RELEASE = np.deg2rad(10.0), np.deg2rad(45.0)  # of the chord
DAMPING_RATIO = 0.1  # of the first mode, about
ELEMENTS = 25
SPACING = LENGTH / (ELEMENTS - 0.5)  # the clamp is in the middle of the first element
TIME_STEP = 1e-6  # s
DURATION, RATE = 6.0, 100  # s, Hz


def statics(bending: float, weight: float, force: float, angle: float) -> tuple:
    """θ(s) of a clamped rod, and the angle of its chord.

    ``weight``: N/m, towards -E2; ``force``: at the tip, N, towards ``angle`` from E1, rad.
    """

    def rates(s, y):
        theta, moment = y[0], y[1]
        down = -weight * (LENGTH - s) + force * np.sin(angle)
        along = force * np.cos(angle)
        x, z = np.cos(theta), np.sin(theta)
        return np.array([moment / bending, -(x * down - z * along), x, z])

    def ends(start, end):
        return np.array([start[0], end[1], start[2], start[3]])

    s = np.linspace(0.0, LENGTH, 200)
    guess = np.array([0 * s, 0 * s, s, 0 * s])
    solution = solve_bvp(rates, ends, s, guess, tol=1e-8, max_nodes=20000)
    assert solution.success
    tip = solution.sol(LENGTH)[2:]
    return (lambda at: solution.sol(at)[0]), float(np.arctan2(tip[1], tip[0]))


class MaterialDamping(ea.NoForces):
    """Couples that resist the rate of curvature: Kelvin and Voigt's solid."""

    def __init__(self, viscosity: float):
        super().__init__()
        self._viscosity = viscosity  # N·m²·s

    def apply_torques(self, system, time=0.0):
        couple = self._viscosity * np.diff(system.omega_collection[0]) / SPACING
        system.external_torques[0, :-1] += couple
        system.external_torques[0, 1:] -= couple


class Simulator(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.CallBacks):
    """What PyElastica simulates."""


class Angles(ea.CallBackBaseClass):
    """Keeps the angle of the chord, and half of the tangent's at the tip."""

    def __init__(self, step_skip: int, rows: list):
        super().__init__()
        self.every, self._rows = step_skip, rows

    def make_callback(self, system, time, current_step):
        if current_step % self.every:
            return
        x, y = system.position_collection[:2]
        chord = np.array([x[-1] - (x[0] + x[1]) / 2, y[-1] - (y[0] + y[1]) / 2])
        tangent = np.unwrap(np.arctan2(*system.director_collection[2, 1::-1]))
        # Curvature falls to zero over the last element, so the tangent turns a little more.
        tip = tangent[-1] + (tangent[-1] - tangent[-2]) / 8
        self._rows.append([time, np.arctan2(chord[1], chord[0]), tip / 2])


def simulate(bending: float, shape, gravity: float, viscosity: float) -> np.ndarray:
    """[time, chord, α/2], s and rad, at 100 Hz for 6 s, from a shape θ(s)."""
    radius = THICKNESS / np.sqrt(3)  # a disc's radius of gyration is then the rectangle's
    area = np.pi * radius**2
    modulus = bending / (np.pi * radius**4 / 4)
    along, normal = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS,
        np.zeros(3),
        along,
        normal,  # so that bending in E1 and E2 is about the first director
        ELEMENTS * SPACING,
        radius,
        MASS / (LENGTH * area),
        youngs_modulus=modulus,
        shear_modulus=modulus / 3,
    )
    theta = shape(SPACING * np.arange(ELEMENTS))
    links = SPACING * np.array([np.cos(theta), np.sin(theta), 0 * theta])
    rod.position_collection[:, 1:] = np.cumsum(links, axis=1)
    rod.director_collection[2] = np.array([np.cos(theta), np.sin(theta), 0 * theta])
    rod.director_collection[1] = np.cross(
        rod.director_collection[2], rod.director_collection[0], axis=0
    )
    simulator, rows = Simulator(), []
    simulator.append(rod)
    simulator.constrain(rod).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    if gravity:
        simulator.add_forcing_to(rod).using(
            ea.GravityForces, acc_gravity=np.array([0.0, -gravity, 0.0])
        )
    simulator.add_forcing_to(rod).using(MaterialDamping, viscosity=viscosity)
    simulator.collect_diagnostics(rod).using(
        Angles, step_skip=round(1 / RATE / TIME_STEP), rows=rows
    )
    simulator.finalize()
    steps = round(DURATION / TIME_STEP)
    ea.integrate(ea.PositionVerlet(), simulator, DURATION, steps, progress_bar=False)
    return np.array(rows)


def main() -> None:
    weight = MASS * GRAVITY / LENGTH
    bending = brentq(lambda b: statics(b, weight, 0.0, 0.0)[1] + SAG, 1e-3, 4e-3)
    across = RELEASE + np.pi / 2  # of a hand at the tip, that pushes across the chord
    push = brentq(lambda f: statics(bending, 0.0, f, across)[1] - RELEASE, 0.1, 0.7)
    first = 3.516 * np.sqrt(bending / (MASS / LENGTH * LENGTH**4))  # rad/s, of the first mode
    viscosity = bending * 2 * DAMPING_RATIO / first
    print(f"EI = {bending:.6g} N·m², viscosity = {viscosity:.4g} N·m²·s, push = {push:.3g} N")
    for name, load, gravity in (
        ("sag", (weight, 0.0, 0.0), GRAVITY),
        ("ring_down", (0.0, push, across), 0.0),
    ):
        rows = simulate(bending, statics(bending, *load)[0], gravity, viscosity)
        columns = rows * [1.0, np.rad2deg(1), np.rad2deg(1)]
        header = "time_s,chord_deg,half_tip_tangent_deg"
        path = Path(__file__).with_name(f"{name}.csv")
        np.savetxt(path, columns, ["%.2f", "%.4f", "%.4f"], ",", header=header, comments="")
        print(path.name, columns[-1])


if __name__ == "__main__":
    main()

"""How well sag and ring-downs tell the stiffness of emulated limbs, and how honest its error is.

k is compared with two stiffnesses of the emulated limb: k of its rubber, and k with which the model
sags as the cold limb does, whose wires resist the bend as well. A planar limb of the model has no
such wires, so that its k contains them.

    nice python benchmarks/stiffness_errors.py [--seeds 8] [--first 0] [crawler nominal broad]
"""

import argparse
import copy

import numpy as np
from scipy.optimize import brentq

from calibration import collect_from_twin, fit_damping, fit_stiffness
from calibration.collecting.measurement_protocol import mounted
from calibration.paper_method.mechanics import with_ringing
from calibration.recordings.at_rest import rest_angles
from hardware import LimbTwin
from hardware.emulation.specimen import Specimen
from limb_systems import LimbParameters, SegmentParameters, simulate
from limb_systems.statics import static_equilibrium
from walking import RobotParameters
from walking.robot_twin import RobotSpecimen

BROAD = SegmentParameters(
    links=4, length=0.08, mass=0.03, width=0.025, thickness=0.012, stiffness=0.4, damping=2.5e-3
)
LIMBS = {
    "crawler": lambda seed: [
        RobotSpecimen(RobotParameters(), seed).limb(name) for name in ("rear", "front")
    ],
    "nominal": lambda seed: [Specimen(LimbParameters(), seed)],
    "broad": lambda seed: [Specimen(LimbParameters(segments=[BROAD]), seed)],
}


def slow_stiffness(specimen: Specimen) -> float:
    """k with which the model sags as the cold emulated limb, by its own angles, to both sides."""
    described, sags = specimen.description, []
    limbs = [mounted(described, turned) for turned in (0.0, 180.0)]
    for limb in limbs:
        twin = LimbTwin(specimen=copy.deepcopy(specimen))
        twin = twin.after_rest(20.0, gravity=limb.gravity, payload=limb.payload, truth=True)
        joints = simulate(twin, [0.0, 0.0], 1.0).joint_state
        sags.append(joints[: described.num_joints, -1].sum())

    def too_soft(k: float) -> float:
        for limb in limbs:
            limb.segments[0].stiffness = k
        modelled = [static_equilibrium(limb)[0].sum() for limb in limbs]
        return modelled[1] - modelled[0] - (sags[1] - sags[0])

    k = described.segments[0].stiffness
    return brentq(too_soft, k / 2, 2 * k)


def errors(case: tuple[str, int]) -> list[list[float]]:
    """Of each limb: errors of k by the sag, the ring-downs and both, its standard error, all over
    the rubber's k, and the slow stiffness over that.
    """
    rows = []
    for specimen in LIMBS[case[0]](case[1]):
        limb, slow = copy.deepcopy(specimen.description), slow_stiffness(specimen)
        brief = {"num_angles": 1, "longest": 20.0, "cooling_time": 60.0}
        found = collect_from_twin(LimbTwin(specimen=specimen), protocol="paper", **brief)
        level = [r for kind, group in found.items() if kind != "sag" for r in group]
        (rest,), (segment,) = rest_angles(level, specimen.ambient), limb.segments
        segment.rest_angle = rest.value
        fit = fit_stiffness(limb, found["sag"], rest.standard_error)
        segment.stiffness = fit.stiffness.value
        damping = fit_damping(limb, found["ring_down"])
        pairs = zip(damping.measured, damping.simulated, strict=True)
        faster = np.mean([m.natural_frequency / s.natural_frequency for m, s in pairs])
        both, k = with_ringing(fit, damping).stiffness, specimen.segments[0].stiffness
        found_k = np.array([fit.by_sag.value, fit.by_sag.value * faster**2, both.value])
        rows.append([*(found_k / k - 1), both.standard_error / k, slow / k])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("limbs", nargs="*", default=list(LIMBS))
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    for name in options.limbs:
        cases = [(name, options.first + seed) for seed in range(options.seeds)]
        rows = np.concatenate([errors(case) for case in cases])
        slow = rows[:, 4]
        print(f"{name}: {len(rows)} limbs; cold and slow, wires add {slow.mean() - 1:.1%} to k")
        said, of = ("sag", "ring-downs", "both"), {"rubber": 1.0, "cold limb": slow}
        for against, truth in of.items():
            for column, by in enumerate(said):
                away = (1 + rows[:, column]) / truth - 1
                print(
                    f"  {by:<10} - {against:<9}: mean {away.mean():+.1%}, root mean square "
                    f"{np.sqrt((away**2).mean()):.1%}, worst {np.abs(away).max():.1%}, within 5% "
                    f"{np.mean(np.abs(away) < 0.05):.0%}"
                )
            covered = np.mean(np.abs(away) * truth < 1.96 * rows[:, 3])
            print(f"  standard error {rows[:, 3].mean():.1%}, covers the {against} {covered:.0%}")


if __name__ == "__main__":
    main()

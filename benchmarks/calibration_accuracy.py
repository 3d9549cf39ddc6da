"""How good calibration is: on ten emulated limbs, and how honest its uncertainties are.

1. Ten twins, whose physics is richer than the model: the calibrated model
   against the recording with both wires, open loop. No target; this is how
   good a linear model can be on such a limb.
2. The model itself behind the robot's sensors, a hundred times with other
   noise: how far the estimates are from the truth, and how often the truth is
   within 1.96 standard errors, which it should be 95% of the time.

    python benchmarks/calibration_accuracy.py [--twins 10] [--seeds 100]
"""

import argparse
import copy

import numpy as np

from calibration import calibrate, collect_equilibria, collect_from_twin, collect_sag
from calibration.collecting.collect import RING_DOWN_RATE
from calibration.collecting.protocol import SAG_TRIALS
from hardware import LimbTwin
from hardware.emulation.sensors import SensedLimb
from limb_systems import Limb, LimbParameters, LinearLaw, joint_angles_from_bend_angle, simulate
from soft_limb.runs.jobs import local_executor


def calibrate_twin(seed: int):
    """Validation errors, degrees and °C."""
    recordings = collect_from_twin(LimbTwin(seed=seed), seed=seed)
    v = calibrate(recordings, method="paper").validation
    return [*np.rad2deg([v.mean, v.median, v.percentile_90]), v.temperature_mean]


def true_limb() -> LimbParameters:
    """A limb that is not the nominal one, from which the fits start."""
    limb = LimbParameters()
    segment = limb.segments[0]
    segment.stiffness, segment.damping = 0.115, 8e-4
    segment.wire("left").law = LinearLaw(a1=-0.06, a2=24.0, a3=-1.3, beta=4.2e-4)
    segment.wire("right").law = LinearLaw(a3=-0.8)
    return limb


def calibrate_model(seed: int) -> dict[str, tuple[float, float]]:
    """Relative error and relative standard error of each estimate."""
    limb = true_limb()
    mounted = copy.deepcopy(limb)
    mounted.gravity = [0.0, -9.81, 0.0]
    bent = joint_angles_from_bend_angle(limb, [np.pi / 4])
    state = np.concatenate([bent, 0 * bent, np.full(4, limb.ambient_temperature)])
    seeds = iter(range(100 * seed, 100 * seed + 100))

    def sensed(parameters, bend_rate=20.0):
        return SensedLimb(Limb(parameters), seed=next(seeds), bend_rate=bend_rate)

    recordings = {
        "sag": [collect_sag(sensed(mounted)) for _ in range(SAG_TRIALS)],
        "ring_down": [
            simulate(
                sensed(limb, RING_DOWN_RATE),
                [0.0, 0.0],
                4.0,
                sample_rate=RING_DOWN_RATE,
                initial_state=state,
            )
            for _ in range(3)
        ],
        "right": [collect_equilibria(sensed(limb), "right", seed=seed)],
        "left": [collect_equilibria(sensed(limb), "left", seed=seed + 1)],
    }
    truth = {"stiffness": 0.115, "damping": 8e-4, "ambient_temperature": limb.ambient_temperature}
    for side in ("left", "right"):
        wire = limb.segments[0].wire(side).law
        truth |= {f"{side}.{name}": getattr(wire, name) for name in ("a1", "a2", "a3", "beta")}
    estimates = calibrate(recordings, LimbParameters(), method="paper").estimates
    return {
        name: (estimate.value / truth[name] - 1, estimate.standard_error / abs(truth[name]))
        for name, estimate in estimates.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--twins", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=100)
    options = parser.parse_args()
    with local_executor(2) as executor:
        print("twin  |φ - φ_sim|: mean  median    90%   |V - V_sim|: mean")
        for seed, row in enumerate(executor.map(calibrate_twin, range(options.twins))):
            print("{:>4}{:>18.2f}°{:>7.2f}°{:>6.2f}°{:>18.1f} °C".format(seed, *row), flush=True)
        results = list(executor.map(calibrate_model, range(options.seeds)))
    print(f"\n{'parameter':<22}{'error: median':>14}{'90%':>8}{'largest':>9}{'covered':>9}")
    for name in results[0] if results else []:
        errors, standard = np.array([result[name] for result in results]).T
        covered = np.mean(np.abs(errors) <= 1.96 * standard)
        sizes = np.percentile(np.abs(errors), [50, 90, 100])
        print("{:<22}{:>14.1%}{:>8.1%}{:>9.1%}{:>9.0%}".format(name, *sizes, covered))


if __name__ == "__main__":
    main()

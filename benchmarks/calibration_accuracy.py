"""How good calibration by the paper's method is, and how honest its standard errors are.

1. Emulated limbs, whose physics is richer than the model: the calibrated model
   against the recording with both wires, open loop. No target; this is how
   good a linear model can be on such a limb.
2. The model itself, recorded once without errors, then again and again with other errors
   of its sensors: noise, drift and steps of the bend sensor, and noise, steps and an offset
   of each thermocouple. Of each estimate: the error, its bias in its own scatter, and how often
   the truth is within 1.96 standard errors, which it should be 95% of the time.

    nice python benchmarks/calibration_accuracy.py [--twins 10] [--seeds 100]
"""

import argparse
import copy
import dataclasses
import functools

import numpy as np

from calibration import calibrate, collect_equilibria, collect_from_twin, collect_sag
from calibration.recordings.at_rest import SENSOR_SPREAD
from hardware import LimbTwin
from hardware.emulation.sensors import (
    BEND_DRIFT_TIME,
    BEND_STEP,
    THERMOCOUPLE_NOISE,
    THERMOCOUPLE_PERIOD,
    THERMOCOUPLE_STEP,
)
from limb_systems import (
    Limb,
    LimbParameters,
    LinearLaw,
    Recording,
    joint_angles_from_bend_angle,
    simulate,
)
from soft_limb.runs.jobs import run_each

TRIALS = {"sag": 10, "ring_down": 3, "right": 1, "left": 1}
HOLD = 1.0  # s before the release


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


def truth() -> dict[str, float]:
    """The true values of the estimates, by name."""
    limb = true_limb()
    (segment,) = limb.segments
    values = {
        "ambient_temperature": limb.ambient_temperature,
        "stiffness": segment.stiffness,
        "damping": segment.damping,
    }
    for wire in segment.wires:
        names = ("a1", "a2", "a3", "beta")
        values |= {f"{wire.name}.{name}": getattr(wire.law, name) for name in names}
    return values


@functools.cache
def exact_recordings() -> dict[str, Recording]:
    """One of each kind, by sensors without errors."""
    limb = true_limb()
    mounted = copy.deepcopy(limb)
    mounted.gravity = [0.0, -9.81, 0.0]
    bent = joint_angles_from_bend_angle(limb, [np.pi / 4])
    state = np.concatenate([bent, 0 * bent, np.full(4, limb.ambient_temperature)])
    swing = simulate(Limb(limb), [0.0, 0.0], 4.0, sample_rate=100.0, initial_state=state)
    recordings = {"sag": collect_sag(Limb(mounted)), "ring_down": _held(swing)}
    for seed, wire in enumerate(("right", "left")):
        recordings[wire] = collect_equilibria(Limb(limb), wire, num_angles=6, seed=seed)
    return recordings


def _held(swing: Recording) -> Recording:
    """A ring-down with the hold before it."""
    count = round(HOLD * swing.sample_rate)

    def before(rows):
        return np.concatenate([np.repeat(rows[..., :1], count, axis=-1), rows], axis=-1)

    return dataclasses.replace(
        swing,
        time=np.arange(count + len(swing.time)) / swing.sample_rate,
        **{
            name: before(getattr(swing, name))
            for name in ("duty", "measured_temperature", "bend_angle", "joint_state")
        },
        wire_temperature=None,
    )


def sensed(recording: Recording, offsets: np.ndarray, random: np.random.Generator) -> Recording:
    """A recording as the robot's sensors would have made it.

    Args:
        recording: by exact sensors.
        offsets: of its thermocouples (W,), °C.
        random: of noise and drift.
    """
    sensor, count = recording.parameters.segments[0].bend_sensor, len(recording.time)
    angle = sensor.apparent_bend_angle(recording.joint_state[: recording.parameters.num_joints])
    memory = np.exp(-1 / recording.sample_rate / BEND_DRIFT_TIME)
    drift = np.empty(count)
    drift[0], steps = random.normal(), np.sqrt(1 - memory**2) * random.normal(size=count)
    for sample in range(1, count):
        drift[sample] = memory * drift[sample - 1] + steps[sample]
    bend = angle + sensor.drift * drift + sensor.noise * random.normal(size=count)
    every = max(1, round(THERMOCOUPLE_PERIOD * recording.sample_rate))
    converted = np.arange(count) // every * every  # a conversion is held until the next
    measured = recording.measured_temperature + offsets[:, None]
    measured = measured + THERMOCOUPLE_NOISE * random.normal(size=measured.shape)
    return dataclasses.replace(
        recording,
        bend_angle=BEND_STEP * np.round(bend[None] / BEND_STEP),
        measured_temperature=(THERMOCOUPLE_STEP * np.round(measured / THERMOCOUPLE_STEP))[
            :, converted
        ],
        joint_state=None,
        wire_temperature=None,
    )


def estimates(seed: int) -> dict[str, tuple[float, float]]:
    """Value and standard error of each estimate, from recordings with the noise of a seed."""
    random = np.random.default_rng(seed)
    offsets = SENSOR_SPREAD * random.normal(size=2)
    recordings = {
        kind: [sensed(recording, offsets, random) for _ in range(TRIALS[kind])]
        for kind, recording in exact_recordings().items()
    }
    found = calibrate(recordings, LimbParameters(), method="paper").estimates
    return {name: (e.value, e.standard_error) for name, e in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--twins", type=int, default=10)
    parser.add_argument("--seeds", type=int, default=100)
    options = parser.parse_args()
    print("twin  |φ - φ_sim|: mean  median    90%   |V - V_sim|: mean")
    for seed, row in enumerate(run_each(calibrate_twin, range(options.twins), 2, in_order=True)):
        print("{:>4}{:>18.2f}°{:>7.2f}°{:>6.2f}°{:>18.1f} °C".format(seed, *row), flush=True)
    results = list(run_each(estimates, range(options.seeds), 2, in_order=True))
    if not results:
        return
    head = ("parameter", "true", "error: 50%", "90%", "bias/true", "bias/σ", "scatter/σ", "covered")
    print("\n{:<22}{:>10}{:>12}{:>8}{:>11}{:>9}{:>11}{:>9}".format(*head))
    for name, true in truth().items():
        values, errors = np.array([result[name] for result in results]).T
        bias, typical = values.mean() - true, np.sqrt(np.mean(errors**2))
        sizes = np.percentile(np.abs(values / true - 1), [50, 90])
        covered = np.mean(np.abs(values - true) <= 1.96 * errors)
        row = bias / true, bias / values.std(), values.std() / typical, covered
        line = "{:<22}{:>10.4g}{:>12.1%}{:>8.1%}{:>11.2%}{:>9.2f}{:>11.2f}{:>9.0%}"
        print(line.format(name, true, *sizes, *row))


if __name__ == "__main__":
    main()

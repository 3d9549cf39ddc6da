"""How honest the standard errors of the paper's fits are.

The model itself is recorded once without errors, then again and again with other errors
of its sensors: noise, drift and steps of the bend sensor, and noise, steps and an offset
of each thermocouple. Prints each estimate's bias, in its own scatter, and how often the
truth is within 1.96 standard errors, which it should be 95% of the time.

    nice python benchmarks/calibration_coverage.py [--seeds 100]
"""

import argparse
import copy
import dataclasses
import functools

import numpy as np
from calibration_accuracy import true_limb

from calibration import calibrate, collect_equilibria, collect_sag
from calibration.recordings.at_rest import SENSOR_SPREAD
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
    Recording,
    joint_angles_from_bend_angle,
    simulate,
)
from soft_limb.runs.jobs import local_executor, run_each

TRIALS = {"sag": 10, "ring_down": 3, "right": 1, "left": 1}
HOLD = 1.0  # s before the release


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
    assert recording.joint_state is not None
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
    parser.add_argument("--seeds", type=int, default=100)
    options = parser.parse_args()
    with local_executor(2) as executor:
        results = list(run_each(estimates, range(options.seeds), executor))
    head = ("parameter", "true", "bias/true", "bias/σ", "scatter/σ", "covered")
    print("{:<22}{:>10}{:>11}{:>9}{:>11}{:>9}".format(*head))
    for name, true in truth().items():
        values, errors = np.array([result[name] for result in results]).T
        bias, typical = values.mean() - true, np.sqrt(np.mean(errors**2))
        covered = np.mean(np.abs(values - true) <= 1.96 * errors)
        row = name, true, bias / true, bias / values.std(), values.std() / typical, covered
        print("{:<22}{:>10.4g}{:>11.2%}{:>9.2f}{:>11.2f}{:>9.0%}".format(*row))


if __name__ == "__main__":
    main()

"""Errors of calibrations of emulated limbs that bend in space, and of plans with them.

Errors are of the wires' angles, of the sensor's roll, and of the bends that wires make
alone, which have the gains over k; then of motions that were left out of the fit, as the sensor
reads them; then of three plans that are replayed open loop, of the true bend from the reference.

With --bursts, limbs of two physics are fitted to 100 s of bursts without thermocouples, read by a
sensor that is turned by 0 to 60°. Questions are answered with the corrected description. Errors are
then of the bend in another run of bursts, open loop, beside the errors of the baselines.
"""

import argparse
import dataclasses
import time
from collections.abc import Iterator

import numpy as np
import witness  # noqa: F401 (its physics)
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from calibration import calibrate, collect_from_twin
from calibration.collecting.measurement_protocol import mounted_limb
from calibration.prediction.baselines import baselines
from calibration.prediction.heated_run import HeatedRun
from calibration.wire_directions import WrongDescriptionError
from hardware import LimbTwin, replay
from limb_systems import Limb, LimbError, LimbParameters, Recording, simulate
from limb_systems.bend_sensor import roll_bends
from limb_systems.tracking import true_bend
from planners import plan, references

LEVEL, HEATED, COOLED = 0.25, 20.0, 40.0  # duty of one wire, to the middle of plans, s, s
BURSTS = 100.0  # s
BURST_COLUMNS = ("RMS °", "mean °", "lag °", "missed °", "from °", "to °")
COLUMNS = ("angles °", "roll °", "gains %", "motions °", "circle °", "eight °", "taught °")


def hand() -> PiecewisePolynomial:
    """Return a hand that leads the limb around for 60 s, after 20 s of rest, rad."""
    times = np.linspace(0.0, 80.0, 81)
    angle = 2 * np.pi / 60 * np.maximum(times - 20.0, 0.0)
    sizes = np.deg2rad([[15.0], [18.0]]) * np.array([np.sin(angle), np.sin(angle / 2) ** 2])
    return PiecewisePolynomial.CubicShapePreserving(times, sizes)


def gains(limb: LimbTwin, calibrated: LimbParameters) -> float:
    """Return the mean relative error of the bends of each wire alone, for the same duty, %."""
    wires = np.eye(len(calibrated.wires))
    levels = [row for wire in wires for row in (LEVEL * wire, 0 * wire)]
    times = np.cumsum([0.0, *[HEATED, COOLED] * len(wires)])
    duty = PiecewisePolynomial.ZeroOrderHold(times, np.array([*levels, levels[-1]]).T)
    bends = []
    for run in (true_bend(simulate(limb, duty)), simulate(Limb(calibrated), duty)):
        away = run.bend_angle - run.bend_angle[:, :10].mean(axis=1, keepdims=True)
        bends.append([away[:, (run.time > t) & (run.time < t + HEATED)] for t in times[:-1:2]])
    ratios = [
        (true * model).sum() / (true * true).sum() for true, model in zip(*bends, strict=True)
    ]
    return 100 * float(np.abs(np.array(ratios) - 1).mean())


def distance(limb: LimbTwin, calibrated: LimbParameters, reference: Trajectory) -> float:
    """Return the mean distance of the true bend from a reference, driven open loop, degrees."""
    try:
        planned = plan(calibrated, reference)
    except LimbError as error:
        print(error)
        return np.nan
    done = true_bend(replay(planned, limb))
    wanted = planned.interpolated(planned.reference, done.time)
    return float(np.rad2deg(np.linalg.norm(done.bend_angle - wanted, axis=0).mean()))


def errors(seed: int, wires: int) -> list[float]:
    """Return the values of `COLUMNS` for one limb."""
    described = mounted_limb(LimbParameters.in_space(wires), None)
    twin = LimbTwin(described, seed=seed)
    calibration = calibrate(collect_from_twin(twin), described)
    limb = calibration.parameters
    true = twin.specimen.mechanics()
    roll = limb.segments[0].bend_sensor.roll

    def unused(**more) -> LimbTwin:
        """Return the same limb, before it was collected."""
        return LimbTwin(described, seed=seed, **more)

    taught = simulate(unused(hand=hand()), np.zeros(wires), 80.0)
    paths = [
        references.circle(np.deg2rad(20.0), 60.0),
        references.eight(np.deg2rad(20.0), np.deg2rad(12.0), 80.0),
        references.from_samples(taught.time[::10], roll_bends(taught.bend_angle, -roll)[:, ::10]),
    ]
    turned = [a.angle - b.angle for a, b in zip(limb.wires, true.wires, strict=True)]
    return [
        float(np.rad2deg(np.abs(np.angle(np.exp(1j * np.array(turned)))).mean())),
        np.rad2deg(abs(roll - twin.specimen.segments[0].sensor_roll)),
        gains(unused(truth=True), limb),
        np.rad2deg(calibration.validation.mean) if calibration.validation else np.nan,
        *(distance(unused(truth=True), limb, path) for path in paths),
    ]


def bursts(random: np.random.Generator, wires: int) -> PiecewisePolynomial:
    """Return duty of 100 s of bursts of one or two wires, after 3 s of rest."""
    times = [0.0]
    levels = [np.zeros(wires)]
    start = 3.0
    while start < BURSTS:
        size = random.uniform(0.2, 0.5)
        order = random.permutation(wires)
        level = np.zeros(wires)
        level[order[: random.choice([1, 1, 2])]] = size
        end = start + random.uniform(2.0, 5.0)
        times += [start, end]
        levels += [level, 0 * level]
        start = end + random.uniform(1.0, 6.0)
    count = int(np.searchsorted(times, BURSTS))
    levels = [*levels[:count], levels[count - 1]]
    return PiecewisePolynomial.ZeroOrderHold([*times[:count], BURSTS], np.transpose(levels))


def recordings_of_bursts(physics: str, wires: int, seed: int) -> Iterator[Recording]:
    """Return two runs of one limb, without thermocouples, by a turned sensor."""
    random = np.random.default_rng([59, seed, wires])
    turn = random.uniform(0.0, np.pi / 3)
    limb = LimbTwin(mounted_limb(LimbParameters.in_space(wires), None), seed=seed, physics=physics)
    for pause in (0.0, 600.0):
        limb = limb.after_rest(pause) if pause else limb
        run = simulate(limb, bursts(random, wires), BURSTS, sample_rate=10.0)
        yield dataclasses.replace(
            run,
            measured_temperature=np.full_like(run.measured_temperature, np.nan),
            bend_angle=roll_bends(run.bend_angle, turn),
        )


def errors_by_bursts(physics: str, wires: int, seed: int) -> tuple[str, list[float]]:
    """Return the law that is used, and the values of `BURST_COLUMNS` for one limb."""
    fitted, other = recordings_of_bursts(physics, wires, seed)
    described = None
    try:
        calibration = calibrate({"heated": [fitted]})
    except WrongDescriptionError as question:
        described = question.corrected
        calibration = calibrate({"heated": [fitted]}, described, as_described=True)
    run = HeatedRun.of(other)
    (predicted,) = calibration.prediction.fit.roll_out([run])
    bends = [
        predicted.bend,
        *(bend for (bend,) in baselines([HeatedRun.of(fitted)], [run]).values()),
    ]
    root_mean_squares = [np.sqrt(np.nanmean((bend - run.bend) ** 2)) for bend in bends]
    miss = calibration.plan_miss
    shown = [*root_mean_squares, predicted.bend_error, miss.low, miss.high]
    return calibration.prediction.best.name, np.rad2deg(shown).tolist()


def compare_bursts(seeds: list[int], wires: int) -> None:
    """Print a row for each limb."""
    print(f"{'limb':24}{'law':28}", *(f"{name:>9}" for name in BURST_COLUMNS))
    for physics in ("lumped", "continuum"):
        for seed in seeds:
            limb = f"{physics} {wires} wires {seed}"
            try:
                law, row = errors_by_bursts(physics, wires, seed)
                print(f"{limb:24}{law:28}", *(f"{value:9.2f}" for value in row), flush=True)
            except LimbError as error:
                print(f"{limb:24}{error}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="*", default=range(10))
    parser.add_argument("--wires", type=int, default=3)
    parser.add_argument("--bursts", action="store_true", help="without thermocouples, see above")
    options = parser.parse_args()
    if options.bursts:
        compare_bursts(options.seeds, options.wires)
        return
    print("seed", *(f"{name:>9}" for name in COLUMNS), "  CPU s")
    rows = []
    for seed in options.seeds:
        started = time.process_time()
        rows.append([*errors(seed, options.wires), time.process_time() - started])
        print(f"{seed:>4}", *(f"{value:9.2f}" for value in rows[-1]), flush=True)
    print("mean", *(f"{value:9.2f}" for value in np.nanmean(rows, axis=0)))


if __name__ == "__main__":
    main()

"""Calibration of a limb that bends about two axes, from mountings turned under gravity.

The limb is the model by other code than the fit's: exact equilibria of all links, and heat in
steps of a tenth of a second.
"""

import dataclasses

import numpy as np
import pytest

from calibration import CalibrationError, calibrate
from calibration.calibrate import _check_better_than_mean
from calibration.collecting.measurement_protocol import mounted_limb
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.in_space import OpenLoopInSpace
from calibration.prediction.law_fit import fit_law
from calibration.recordings.at_rest import rest_angles
from calibration.recordings.kinds import MOUNTING_ANGLES
from calibration.wire_directions import (
    WireDirection,
    WrongDescriptionError,
    check_directions,
    wire_directions,
)
from limb_systems import LimbModel, LimbParameters, LinearLaw, Recording, RestMemory
from limb_systems.monte_carlo import draw_limbs, stack_limbs

RATE, DRIFT = 4.0, np.deg2rad(0.1)
TRUE = {
    "stiffness": 0.135,
    "stiffness_ratio": 1.05,
    "rest_angle": np.deg2rad(1.5),
    "rest_angle_e3": np.deg2rad(-1.0),
    "bend_sensor.roll": np.deg2rad(4.0),
    **{f"wire_{n}.beta": beta for n, beta in enumerate((4.2e-4, 5.1e-4, 4.6e-4), 1)},
    **{f"wire_{n}.a2": a2 for n, a2 in enumerate((18.0, 21.0, 23.0), 1)},
    **{f"wire_{n}.angle": np.deg2rad(at) for n, at in enumerate((3.0, 115.0, -116.0), 1)},
}


def described() -> LimbParameters:
    limb = LimbParameters.in_space()
    limb.segments[0].bend_sensor.drift = DRIFT
    return limb


def true_limb() -> LimbParameters:
    """The described limb as it is in truth."""
    limb = described()
    segment = limb.segments[0]
    for name, value in TRUE.items():
        owner, _, field = name.rpartition(".")
        wires = [wire for wire in segment.wires if wire.name == owner]
        owners = [segment] if not owner else [segment.bend_sensor, *(w.law for w in wires), *wires]
        setattr(next(o for o in reversed(owners) if hasattr(o, field)), field, float(value))
    return limb


def recording_of(turned: float | None, seed: int, levels: list[list[float]]) -> Recording:
    """Each level held for 15 s, then 15 s without duty, as a noisy, drifting sensor shows it."""
    limb = mounted_limb(true_limb(), turned)
    wires, random = LimbModel.of(limb).wires, np.random.default_rng(seed)
    parts = np.array([[0.0] * 3, *(row for level in levels for row in (level, [0.0] * 3))])
    times = np.arange(0.0, 15.0 * len(parts), 1 / RATE)
    duty = np.repeat(parts, round(15 * RATE), axis=0)  # from each sample to the next
    states, readings = [wires.cold_states], [wires.cold_states[:3]]
    for level in duty[:-1]:
        heat = np.concatenate([states[-1], readings[-1]])
        for _ in range(2):  # steps of 0.125 s
            middle = heat + 0.0625 * wires.heat_rates(heat, level)
            heat = heat + 0.125 * wires.heat_rates(middle, level)
        states.append(heat[: wires.num_states])
        readings.append(heat[wires.num_states :])
    angles = LimbModel.of(limb).statics.angles(np.array(states))
    (segment,) = limb.segments
    seen = segment.bend_sensor.apparent_bends(LimbModel.of(limb).mechanics.chains[0], angles.T)
    noise = np.deg2rad(0.3) * random.standard_normal(seen.shape)
    return Recording(
        time=times,
        duty=np.concatenate([duty[:1], duty[:-1]]).T,
        measured_temperature=np.array(readings).T + 0.3 * random.standard_normal((3, len(times))),
        bend_angle=seen + noise + DRIFT * random.standard_normal((2, 1)),
        parameters=mounted_limb(described(), turned),
        source=f"limb turned by {turned}°",
        sample_rate=RATE,
    )


STAIRS = [[0.3, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [0.2, 0.2, 0], [0, 0.2, 0.2]]


@pytest.fixture(scope="module")
def motion() -> Recording:
    return recording_of(None, 9, [[0.25, 0.1, 0], [0.1, 0, 0.3], [0.15, 0.25, 0.1]])


def test_four_mountings_tell_directions_gains_and_stiffness(motion):
    heated = [recording_of(turned, seed, STAIRS) for seed, turned in enumerate(MOUNTING_ANGLES)]
    runs = [HeatedRun.of(recording) for recording in (*heated, motion)]
    fit = fit_law(LinearLaw, runs, described().segments[0], described().ambient_temperature)
    off = {}
    for name, true in TRUE.items():
        estimate = fit.estimates[name]
        off[name] = abs(estimate.value - true)
        assert off[name] < 3.0 * estimate.standard_error, name
        allowed = np.deg2rad(1.5) if estimate.unit == "rad" else 0.04 * true
        assert estimate.standard_error < allowed, name
    angles = [off[f"wire_{n}.angle"] for n in (1, 2, 3)]
    assert np.rad2deg(np.mean(angles)) < 1.0
    for name in ("stiffness", "wire_1.beta", "wire_2.beta", "wire_3.beta"):
        assert off[name] / TRUE[name] < 0.02, name
    assert np.rad2deg(fit.predicted[-1].bend_error) < 0.7  # of two angles with 0.3° of noise each
    limb = fit.calibrated(described())
    assert limb.segments[0].wires[1].angle == pytest.approx(TRUE["wire_2.angle"], abs=0.03)
    drawn = draw_limbs(limb, 50)
    spread = np.std([each.segments[0].wires[0].angle for each in drawn])
    assert spread == pytest.approx(fit.estimates["wire_1.angle"].standard_error, rel=0.4)


def test_the_open_loop_in_space_shows_exact_equilibria():
    """Of wires hotter than in any plan, in several mountings at once, with joints that twist."""
    limb, (own,) = true_limb(), true_limb().segments
    limb.segments = [own]
    own.stiffening, own.twists = 0.1, True
    limbs = [mounted_limb(limb, turned) for turned in (None, 0, 90)]
    hot = np.random.default_rng(0).uniform(25.0, 110.0, (40, 3))
    loads = [[*each.gravity, each.payload] for each in limbs for _ in hot]
    law, ambient, rubber = stack_limbs([limb])
    rubber |= {
        name: np.array([getattr(own, name)]) for name in ("stiffness_ratio", "rest_angle_e3")
    }
    rubber |= {"roll": np.array([own.bend_sensor.roll])}
    rubber |= {"angle": np.array([[wire.angle for wire in own.wires]])}
    heat = np.tile(hot, (3, 1))[None]
    open_loop = OpenLoopInSpace(np.zeros((1, len(loads), 3)), 0.5, own, loads)
    rooms = np.full((1, len(loads)), ambient[0])
    _, _, bends = open_loop.simulate(law, rooms, [heat, heat], rubber)
    chain = LimbModel.of(limb).mechanics.chains[0]
    angles = np.concatenate([LimbModel.of(each).statics.angles(hot) for each in limbs])
    exact = own.bend_sensor.apparent_bends(chain, angles.T).T
    assert np.rad2deg(np.linalg.norm(exact, axis=1)).max() > 45.0
    at_start = bends[: len(loads), :, 0]
    assert np.rad2deg(np.abs(at_start - exact)).max() < 0.03


def test_thermocouples_are_those_of_their_own_wires():
    recording = recording_of(0, 0, STAIRS[:3])
    recording.measured_temperature[:2] = np.nan
    fit = fit_law(LinearLaw, [HeatedRun.of(recording)], described().segments[0], 22.0)
    assert [unknown.name for unknown in fit.unidentified] == ["wire_1.a3", "wire_2.a3"]


def test_the_angle_at_rest_is_told_towards_both_axes(motion):
    turned = described()
    turned.segments[0].bend_sensor.roll = TRUE["bend_sensor.roll"]
    for estimate, name in zip(
        rest_angles([dataclasses.replace(motion, parameters=turned)], 25.0),
        ("rest_angle", "rest_angle_e3"),
        strict=True,
    ):
        assert abs(estimate.value - TRUE[name]) < 3.0 * estimate.standard_error + np.deg2rad(0.3)


def test_the_memory_of_the_rest_angle_is_that_of_the_model():
    """Two wires are heated in turn; the model is simulated in small steps by other code."""
    limb = true_limb()
    limb.gravity = [0.0, 0.0, 0.0]
    (own,) = limb.segments
    own.stiffness_ratio, own.bend_sensor.roll = 1.3, 0.0
    own.rest_memory = RestMemory(shift=np.deg2rad(6.0), rate=2.0)
    duty = np.repeat([[0.3, 0, 0], [0.0, 0.3, 0], [0.0, 0, 0]], 30, axis=0)
    law, ambient, rubber = stack_limbs([limb])
    rubber |= {
        name: np.array([getattr(own, name)]) for name in ("stiffness_ratio", "rest_angle_e3")
    }
    rubber |= {"roll": np.zeros(1), "angle": np.array([[wire.angle for wire in own.wires]])}
    open_loop = OpenLoopInSpace(duty[:, None], 0.5, own, [[0.0] * 4])
    cold = np.full((1, 1, 3), ambient[0])
    _, _, bends = open_loop.simulate(law, ambient[:, None], [cold, cold], rubber)
    wires, state = LimbModel.of(limb).wires, LimbModel.of(limb).wires.cold_states
    for level in np.repeat(duty, 50, axis=0):
        state = state + 0.01 * wires.rates(state, level)
    shown = own.bend_sensor.apparent_bends(
        LimbModel.of(limb).mechanics.chains[0], LimbModel.of(limb).statics.angles(state[None]).T
    )
    own.rest_memory = None
    forgot = own.bend_sensor.apparent_bends(
        LimbModel.of(limb).mechanics.chains[0], LimbModel.of(limb).statics.angles(state[None, :3]).T
    )
    assert np.rad2deg(np.linalg.norm(shown - forgot)) > 1.0
    assert np.rad2deg(np.abs(bends[-1, :, 0] - shown[:, 0])).max() < 0.1


def test_bends_alone_tell_a_limb_that_bends_in_space(motion):
    """Without thermocouples, by the limb's own law; the other recording has other levels."""
    alone = dataclasses.replace(motion, measured_temperature=np.nan * motion.measured_temperature)
    other = recording_of(None, 11, [[0, 0.25, 0.1], [0.3, 0, 0.1]])
    calibration = calibrate({"heated": [alone]}, laws=[LinearLaw], counted_limit=80.0)
    run = HeatedRun.of(other)
    (predicted,) = calibration.prediction.fit.roll_out([run])
    assert np.rad2deg(predicted.bend_error) < 1.5
    assert np.rad2deg(np.nanmax(np.abs(run.bend))) > 15.0
    assert calibration.plan_miss.low < predicted.bend_error < calibration.plan_miss.high
    no_better = dataclasses.replace(calibration.prediction, mean_error=np.deg2rad(0.1))
    with pytest.raises(CalibrationError, match=r"tell no model: .* misses such a motion by 0\.1°"):
        _check_better_than_mean(dataclasses.replace(calibration, prediction=no_better))
    limb = calibration.parameters
    assert limb.temperature_limits.maximum == 80.0
    assert [wire.law.a2 for wire in limb.wires] == pytest.approx(3 * [LinearLaw().a2])
    assert not limb.calibration.heat_measured
    assert "unmeasured" in {remark.kind for remark in calibration.remarks}
    assert not {"ambient_temperature", "wire_1.a2", "wire_1.a3"} & calibration.estimates.keys()


def test_wires_that_may_as_well_be_exchanged_are_a_question(motion):
    """Two wires that are heated alike; a recording of both in turn tells them apart."""
    together = recording_of(None, 12, [[0.0, 0.2, 0.2], [0.2, 0.0, 0.0], [0.0, 0.25, 0.25]])
    directions = wire_directions([HeatedRun.of(together)], described().segments[0])
    with pytest.raises(WrongDescriptionError, match="wire_2 and wire_3 may as well be exchanged"):
        check_directions(directions, described())
    runs = [HeatedRun.of(together), HeatedRun.of(motion)]
    check_directions(wire_directions(runs, described().segments[0]), described())


@pytest.mark.parametrize(
    ("wires", "roll_deg", "first_off_deg"),
    [((0, 2, 1), 0.0, 0.0), ((0, 1, 2), 60.0, 0.0), ((1, 0, 2), 0.0, 0.0), ((0, 1, 2), 0.0, 70.0)],
)
def test_a_description_that_recordings_contradict_is_a_question(
    motion, wires, roll_deg, first_off_deg
):
    """Wires elsewhere and a turned sensor are found by the bend alone, with what is right."""
    limb = described()
    (segment,) = limb.segments
    angles = [wire.angle for wire in segment.wires]
    check_directions(wire_directions([HeatedRun.of(motion)], segment), limb)
    for wire, place in zip(segment.wires, wires, strict=True):
        wire.angle = angles[place]
    segment.wires[0].angle += np.deg2rad(first_off_deg)
    segment.bend_sensor.roll = np.deg2rad(roll_deg)
    with pytest.raises(WrongDescriptionError) as error:
        check_directions(wire_directions([HeatedRun.of(motion)], segment), limb)
    (right,) = error.value.corrected.segments
    assert np.rad2deg(abs(right.bend_sensor.roll)) < 10.0
    for wire, angle in zip(right.wires, angles, strict=True):
        assert np.rad2deg(abs(np.angle(np.exp(1j * (wire.angle - angle))))) < 15.0


@pytest.mark.parametrize("off_deg", [50.0, -50.0])
def test_wires_are_exchangeable_if_both_lie_between_their_places(off_deg):
    """Or else not: at 50° and 70°, or at -50° and 170°, of 0° and 120°."""
    limb = LimbParameters.in_space(wires=3)
    directions = []
    for wire, off, error in zip(
        limb.wires, (off_deg, -off_deg, 0.0), (25.0, 25.0, 5.0), strict=True
    ):
        off = np.deg2rad(off)
        directions.append(
            WireDirection(wire.name, wire.angle + off, off, np.deg2rad(error), 4.0, 0.9)
        )
    if off_deg < 0.0:
        check_directions(directions, limb)
        return
    with pytest.raises(WrongDescriptionError, match="wire_1 and wire_2 may as well be exchanged"):
        check_directions(directions, limb)

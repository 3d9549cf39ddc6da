"""Calibration by prediction error, on data of known laws."""

import copy
import dataclasses
import functools
import types
from unittest import mock

import casadi as ca
import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from calibration.collecting.excitation import excitations
from calibration.prediction.baselines import DELAYS, baseline_errors, heat_by_duty
from calibration.prediction.expected_plan_error import PlanMiss, plan_miss, remarks_on_coverage
from calibration.prediction.heated_run import HeatedRun
from calibration.prediction.law_fit import LawFit, Predicted, fit_law
from calibration.prediction.residual_noise import ResidualNoise
from calibration.prediction.selection import (
    Prediction,
    compare_laws,
    error_reduction,
    fit_by_prediction,
    is_beaten,
    simplest_unbeaten_law,
)
from calibration.prediction.unknowns import (
    laws_before_fit,
    slopes_of,
    unknowns_of,
    values_of,
)
from calibration.remarks import CalibrationError, remarks_on_start
from limb_systems import (
    CoupledLaw,
    HystereticLaw,
    Limb,
    LimbError,
    LimbParameters,
    LinearLaw,
    Recording,
    RestMemory,
    SaturatingLaw,
    SegmentParameters,
    TwoMassLaw,
    simulate,
)
from limb_systems.law_functions import law_points, law_step, with_fields
from limb_systems.monte_carlo import OpenLoop, draw_limbs, parameter_owner, stack_limbs
from limb_systems.ragged_rows import RaggedRows

AMBIENT = 22.0
LAWS = {
    "linear": lambda: LinearLaw(a1=-0.06, a2=18.0, a3=-0.8),
    "two masses": lambda: TwoMassLaw(a1=-0.09, a2=24.0, a3=-0.7),
    "hysteretic": lambda: HystereticLaw(a2=21.0, a3=-0.9, heating_middle=69.0),
    "coupled": lambda: CoupledLaw(a2=24.0, a3=-0.9, heating_middle=69.0, latent_heat=12.0),
}


def limb_with(law) -> LimbParameters:
    limb = LimbParameters(ambient_temperature=AMBIENT)
    limb.segments[0].links = 2  # which Drake simulates fast
    left, right = limb.wires
    left.law, right.law = law(), law()
    right.law.a2 *= 1.1
    return limb


SEGMENT = SegmentParameters(links=2)


@functools.cache
def recording_of(name: str, excitation: str) -> Recording:
    """A recording of the model itself, by Drake, with a law and one of the excitations.

    Duty changes just after samples, as that of controllers does, so that the sample after shows it.
    """
    with mock.patch("calibration.collecting.excitation.LEVEL_STEP", 2.0):  # each takes Drake long
        (duty,) = [e.duty for e in excitations(2) if e.name == excitation]
    return simulate(Limb(limb_with(LAWS[name])), later(duty), sample_rate=10.0)


@functools.cache
def fit_of(name: str, *names: str) -> LawFit:
    """The law of that name, fitted to such recordings from other values."""
    runs = [HeatedRun.of(recording_of(name, excitation)) for excitation in names]
    return fit_law(type(LAWS[name]()), runs, SEGMENT, AMBIENT + 0.3)


def later(run: PiecewisePolynomial) -> PiecewisePolynomial:
    """Steps of duty, each 1 ms later."""
    times = np.array(run.get_segment_times())
    levels = [run.value(t)[:, 0] for t in times]
    times[1:] += 1e-3
    return PiecewisePolynomial.ZeroOrderHold(times, np.transpose(levels))


@pytest.mark.parametrize(
    "names",
    [
        ("linear", "conditioning", "ramps"),
        pytest.param(("coupled", "ramps"), marks=pytest.mark.whole),
    ],
)
def test_a_law_is_found_again_in_its_own_data(names):
    """By another integrator than Drake's, from other values; within their errors."""
    true, fit = limb_with(LAWS[names[0]]), fit_of(*names)
    found = LimbParameters(segments=[SegmentParameters(links=2)])
    fit.apply(found)
    for wire, fitted in zip(true.wires, found.wires, strict=True):
        for field in dataclasses.fields(fitted.law):
            estimate = fit.estimates[f"{wire.name}.{field.name}"]
            assert estimate.value == getattr(fitted.law, field.name)
            away = abs(estimate.value - getattr(wire.law, field.name))
            assert away < max(0.02 * abs(estimate.value), 1.5 * estimate.standard_error), estimate
    assert max(p.bend_error for p in fit.predicted) < np.deg2rad(0.15)
    assert max(p.temperature_error for p in fit.predicted) < 0.3


def test_the_simplest_law_that_predicts_as_well_is_used():
    names = "conditioning", "pulses", "motion_1"
    *heated, motion = (recording_of("two masses", name) for name in names)
    noise = np.random.default_rng(0)
    runs = []
    for recording in (*heated, motion):
        noisy = dataclasses.replace(
            recording,
            bend_angle=recording.bend_angle + noise.normal(0, 0.008, recording.bend_angle.shape),
        )
        runs.append(HeatedRun.of(noisy))
    candidates, best = compare_laws(
        (LinearLaw, TwoMassLaw, SaturatingLaw),
        runs[:-1],
        runs[-1:],
        SEGMENT,
        AMBIENT,
        options=("rest_memory",),
    )
    assert [c.name for c in candidates][:3] == ["LinearLaw", "TwoMassLaw", "SaturatingLaw"]
    assert candidates[-1].name == "TwoMassLaw + rest_memory"
    assert best.name == "TwoMassLaw"
    assert is_beaten(candidates[0], candidates[1])
    chosen = Prediction(candidates, best, best.fit, "", [], [], 0.0)
    assert ("is nearer to what judged" in chosen.choice) == (
        min(candidates, key=lambda c: c.bend_error) is not best
    )
    memory = candidates[-1].fit
    assert memory.misfit <= best.fit.misfit  # the law that it contains
    assert not is_beaten(candidates[1], candidates[2])
    assert simplest_unbeaten_law(candidates[1:3]) is candidates[1]


def test_the_open_loop_is_the_diagram_with_rubber_that_remembers():
    """Against Drake's simulation of the whole limb, with its mechanics."""
    limb = limb_with(LAWS["hysteretic"])
    segment = limb.segments[0]
    segment.rest_angle, segment.stiffening = 0.05, 0.3
    segment.rest_memory = RestMemory(0.03, 2.0)
    (duty,) = [e.duty.slice(0, 3) for e in excitations(2) if e.name == "conditioning"]
    run = HeatedRun.of(simulate(Limb(limb), later(duty), sample_rate=10.0, accuracy=1e-2))
    law, ambient, rubber = stack_limbs([limb])
    cold = [np.full((1, 1, 2), value) for value in law.cold_states(AMBIENT)]
    open_loop = OpenLoop(run.duty[:, np.newaxis], 0.5, segment)
    _, readings, bends = open_loop.simulate(
        law, ambient[:, np.newaxis], [*cold, np.full((1, 1, 2), AMBIENT)], rubber
    )
    signals = np.concatenate([bends, readings], axis=1)
    away = np.abs(run.interpolated(signals[..., 0]) - run.signals)
    assert away[:, 1:].max() < 0.8
    assert np.rad2deg(away[:, 0]).mean() < 0.1


class AngleLaw(HystereticLaw):
    """A lab's law, whose torque falls with the angle."""

    def torque(self, x, T0, theta):
        return super().torque(x, T0, theta) * (1.0 - 0.2 * theta)


@pytest.mark.parametrize(
    ("kind", "step", "level"),
    [(HystereticLaw, 0.5, 0.3), (HystereticLaw, 4.0, 0.9), (AngleLaw, 0.5, 0.3)],
)
def test_sets_near_the_first_are_simulated_by_its_derivatives(kind, step, level):
    """Against each set alone, in runs of two lengths; long steps reach the bounds of memories."""
    law = kind()
    law.a2 = np.array([[[21.0]], [[21.01]], [[21.0]]]) * np.ones(2)
    law.width = np.array([[[9.0]], [[9.0]], [[9.01]]]) * np.ones(2)
    duty = np.zeros((80, 2, 2))
    duty[5:20, :, 0] = level
    duty[30:, 1] = level / 1.5
    open_loop = OpenLoop(duty, step, SEGMENT, [80, 50])
    start = [np.full((3, 2, 2), value) for value in [*law.cold_states(AMBIENT), AMBIENT]]
    start[list(law.states).index("xi")][1] = 1e-3
    rubber = {"stiffness": np.full(3, 0.12), "rest_angle": np.zeros(3)}
    ambient = np.full((3, 2), AMBIENT)
    exact, linear = (
        open_loop.simulate(law, ambient, start, rubber, near_first=near_first)
        for near_first in (False, True)
    )
    for each, one in zip(exact, linear, strict=True):
        change = each - each[..., :1]
        np.testing.assert_allclose(one[..., 0], each[..., 0], rtol=1e-12)
        np.testing.assert_allclose(one - one[..., :1], change, atol=0.01 * np.abs(change).max())


def test_residuals_are_whitened_by_their_covariance():
    """Against the Cholesky factor of the whole covariance, with samples that are missing."""
    random = np.random.default_rng(0)
    rows = RaggedRows([35, 40])
    times = np.empty(75)
    for own in rows.of_sequence:
        times[own] = np.cumsum(random.uniform(0.2, 1.0, len(own)))
    variance = random.uniform(0.1, 1.0, 75)
    variance[rows.of_sequence[0][5]] = np.inf
    sizes, memories = np.array([[0.5, 0.4], [1.0, 2.0]]), np.array([[300.0, 120.0], [8.0, 0.4]])
    residuals = np.where(np.isinf(variance), 0.0, random.standard_normal(75))[:, None]
    whitened = ResidualNoise(rows, times, variance, sizes, memories).whiten(residuals)
    for signal, own in enumerate(rows.of_sequence):
        present = own[np.isfinite(variance[own])]
        lags = np.abs(times[present][:, None] - times[present])
        covariance = np.diag(variance[present])
        for size, memory in zip(sizes[:, signal], memories[:, signal], strict=True):
            covariance += size**2 * np.exp(-lags / memory)
        expected = np.linalg.solve(np.linalg.cholesky(covariance), residuals[present])
        np.testing.assert_allclose(whitened[present], expected, atol=1e-12)
    assert not whitened[~np.isfinite(variance)].any()


def test_errors_of_laws_differ_by_a_mean_over_blocks_with_its_standard_error():
    """In degrees: 1, 2 and 3 in three blocks of the judges, and 2 in both blocks of the fit."""

    def of_errors(errors_deg):
        times = np.arange(0.0, 10.0 * len(errors_deg))
        readings = np.full((len(times), 2), 25.0)
        bend = np.deg2rad(np.repeat(errors_deg, 10))[:, None]
        run = types.SimpleNamespace(times=times, bend=np.zeros_like(bend), temperature=readings)
        return [types.SimpleNamespace(run=run, bend=bend, temperature=readings)]

    simple, better = (
        types.SimpleNamespace(
            judged=of_errors(judged), fit=types.SimpleNamespace(predicted=of_errors(fitted))
        )
        for judged, fitted in (([1.0, 2.0, 3.0], [2.0, 2.0]), ([0.0, 0.0, 0.0], [0.0, 0.0]))
    )
    assert error_reduction(better, simple) == pytest.approx((2.0, np.sqrt(1.0 / 3.0) / 2.0))


def test_the_lag_of_each_wire_has_the_delay_that_fits():
    run = HeatedRun.of(recording_of("linear", "motion_1"))
    for delay in DELAYS:
        heat = heat_by_duty(run, delay)
        lagged = dataclasses.replace(run, bend=0.05 + heat @ [[-0.1], [0.2]])
        assert baseline_errors([lagged], [lagged])["a lag of each wire"] < 1e-9


@dataclasses.dataclass
class BranchLaw(LinearLaw):
    """A lab's law with a branch on numbers, which symbols pass as nan, on its other side."""

    def rates(self, x, D, T0):
        if float(x[0]) > -40.0:
            return super().rates(x, D, T0)
        return [self.a2 * D - 10.0 * (x[0] - T0)]


@dataclasses.dataclass
class ComparingLaw(LinearLaw):
    """A lab's law with a branch that symbols refuse."""

    def rates(self, x, D, T0):
        return super().rates(x, D if x[0] > -40.0 else 0.0, T0)


RATES_OF_LABS = {
    # Arrays of fields, which symbols do not allow; and a product that means another of arrays.
    "rows": lambda law, x, D, T0: np.array([law.a1, law.a2])[:1] * (x[0] - T0) + law.a2 * D,
    "matrix": lambda law, x, D, T0: np.array([[law.a1, law.a2]]) @ np.array([x[0] - T0, D]),
    "branch": BranchLaw.rates,
    # A function that is not smooth, and a function of CasADi, which takes no arrays.
    "maximum": lambda law, x, D, T0: LinearLaw.rates(law, [np.maximum(x[0], -40.0)], D, T0),
    "casadi": lambda law, x, D, T0: LinearLaw.rates(law, [ca.fmax(x[0], -40.0)], D, T0),
}


@pytest.mark.parametrize("name", RATES_OF_LABS)
def test_a_law_that_takes_numbers_alone_is_fitted(name):
    law = dataclasses.dataclass(type(f"{name}Law", (BranchLaw,), {"rates": RATES_OF_LABS[name]}))
    run = HeatedRun.of(recording_of("linear", "motion_1"))
    fit, expected = (fit_law(each, [run], SEGMENT, AMBIENT) for each in (law, LinearLaw))
    assert fit.misfit == pytest.approx(expected.misfit, rel=1e-3)
    errors = np.sqrt(np.diag(expected.covariance))
    np.testing.assert_allclose(fit.fitted, expected.fitted, atol=0.02 * errors.max())


@dataclasses.dataclass
class SwitchedLaw(LinearLaw):
    """A lab's law, of which a word chooses the equations, and with a field without a range."""

    cooling: str = "even"
    factor: float = 1.0

    def rates(self, x, D, T0):
        law = BranchLaw if self.cooling == "uneven" else LinearLaw
        return law.rates(self, x, self.factor * D, T0)


@dataclasses.dataclass
class SupplyLaw(LinearLaw):
    """A lab's law, of which a word halves the heat, and a field without a range, too."""

    supply: str = "whole"
    factor: float = 1.0

    def rates(self, x, D, T0):
        return super().rates(x, (0.5 if self.supply == "half" else 1.0) * self.factor * D, T0)


def test_words_and_fields_without_a_range_stay_as_described():
    law = functools.partial(SupplyLaw, supply="half", factor=0.8)
    (described,) = limb_with(law).segments
    run = HeatedRun.of(recording_of("linear", "motion_1"))
    fit, expected = (
        fit_law(each, [run], segment, AMBIENT)
        for each, segment in ((SupplyLaw, described), (LinearLaw, SEGMENT))
    )
    limb = fit.calibrated(limb_with(LinearLaw))
    for wire in limb.wires:
        assert (type(wire.law), wire.law.supply, wire.law.factor) == (SupplyLaw, "half", 0.8)
        a2 = expected.estimates[f"{wire.name}.a2"]
        assert wire.law.a2 == pytest.approx(a2.value / 0.4, rel=0.1)
    # A wire that is described by another law gets the words.
    mixed = copy.deepcopy(described)
    mixed.wires[0].law = LinearLaw()
    assert [law.supply for law in laws_before_fit(SupplyLaw, mixed)] == ["half", "half"]
    described.wires[0].law.supply = "whole"
    with pytest.raises(LimbError, match="several words for supply, half and whole; use one"):
        fit_law(SupplyLaw, [run], described, AMBIENT)


@dataclasses.dataclass
class GainLaw(LinearLaw):
    """A lab's law with a field without a default."""

    gain: float = dataclasses.field(kw_only=True)


def test_no_limb_is_built_of_symbols_that_differ_from_the_law_in_numbers():
    with pytest.raises(LimbError, match="BranchLaw gives other values with symbols"):
        Limb(limb_with(BranchLaw))
    with pytest.raises(LimbError, match=r"law \(ComparingLaw\) takes no symbols: .* truth value"):
        Limb(limb_with(ComparingLaw))
    with pytest.raises(LimbError, match="field gain of GainLaw has no default, from which"):
        Limb(limb_with(functools.partial(GainLaw, gain=1.0)))
    Limb(limb_with(SwitchedLaw))
    with pytest.raises(LimbError, match="SwitchedLaw gives other values with symbols"):
        Limb(limb_with(functools.partial(SwitchedLaw, cooling="uneven")))


def test_a_field_of_a_law_needs_no_range():
    law = with_fields(SwitchedLaw, {"factor": np.full((1, 1, 1), 2.0)})
    points = law_points(law, np.array([[30.0], [28.0]]), np.array([20.0]), 0.1)
    twice = law_points(LinearLaw(), np.array([[30.0], [28.0]]), np.array([20.0]), 0.2)
    expected = law_step(LinearLaw(), 0.1).values(np.moveaxis(twice, 0, -1))
    values = law_step(law, 0.1).values(points.reshape(len(points), 1).T)
    np.testing.assert_allclose(values, expected, rtol=1e-9)


def test_draws_scatter_as_the_covariance_says(emulated_folder):
    limb = LimbParameters.load(emulated_folder / "calibrated.yaml")
    draws, record = draw_limbs(limb, 2000), limb.calibration
    for name in ("left.a2", "right.heating_middle", "stiffness", "rest_angle"):
        row = record.names.index(name)
        owners = [parameter_owner(draw, name) for draw in draws]
        values = np.array([getattr(owner, field) for owner, field in owners])
        error = record.standard_errors[row]
        assert values.mean() == pytest.approx(record.values[row], abs=0.1 * error)
        assert values.std() == pytest.approx(error, rel=0.1)


def test_no_fit_has_a_wire_transform_back_hotter_than_it_transformed():
    """Wherever a fit may end; and errors are those of the values."""
    unknowns = unknowns_of(HystereticLaw, SEGMENT)
    random = np.random.default_rng(0)
    for share in (0.0, 1.0, *random.random(20)):
        fitted = np.array([u.low + (u.high - u.low) * share for u in unknowns])
        values = dict(zip([u.name for u in unknowns], values_of(unknowns, fitted), strict=True))
        for wire in ("left", "right"):
            assert values[f"{wire}.cooling_middle"] < values[f"{wire}.heating_middle"]
    fitted = np.array([u.center for u in unknowns])
    steps = fitted + 1e-6 * np.eye(len(fitted))
    away = [np.subtract(values_of(unknowns, x), values_of(unknowns, fitted)) for x in steps]
    np.testing.assert_allclose(np.transpose(away) / 1e-6, slopes_of(unknowns, fitted), atol=1e-4)


def test_a_plan_is_expected_to_miss_by_what_is_left_and_by_what_is_unknown():
    limb = fit_of("two masses", "conditioning").calibrated(limb_with(LAWS["two masses"]))
    run = HeatedRun.of(recording_of("two masses", "motion_1"))

    def miss(error: float, *, judged_share: float = 1.0, fitted_share: float = 1.0) -> PlanMiss:
        groups = []
        for share in (judged_share, fitted_share):
            smaller = dataclasses.replace(run, bend=share * run.bend)
            groups.append([Predicted(smaller, run.temperature, smaller.bend + error)])
        return plan_miss(limb, *groups, [error], 2.0 * error)

    unknown = miss(0.0).expected
    assert np.deg2rad(0.3) < unknown < np.deg2rad(4.0)  # the sensor's drift is 1°
    assert miss(0.1).expected > 0.99 * np.hypot(unknown, 0.1)
    # Plans will exceed what judged, or what was fitted.
    assert miss(0.1, judged_share=0.3).expected > 1.3 * miss(0.1).expected
    assert miss(0.1, fitted_share=0.3).expected > 1.3 * miss(0.1).expected
    assert f"will miss by 0.0° to {np.rad2deg(2 * unknown):.1f}°" in miss(0.0).in_words
    assert miss(0.1).low == pytest.approx(0.05)
    assert [r.kind for e in (0.0, 0.1, 1.0) for r in miss(e).remarks] == ["off", "far"]
    assert limb.calibration is not None
    limb.calibration.covariance = (100 * np.array(limb.calibration.covariance)).tolist()
    assert miss(0.0).expected > 1.5 * unknown


def test_recordings_must_be_as_hot_as_plans_and_turn_back():
    limb, run = limb_with(LAWS["linear"]), HeatedRun.of(recording_of("linear", "conditioning"))
    course = np.array([22.0, 95.0, 30.0, 95.0, 30.0])
    for heated, said in (
        (course, []),
        (course[:3], ["is heated and cools once"] * 2),
        (0.5 * course, ["was read at 48 °C at most, and plans may heat it to 100 °C"] * 2),
    ):
        temperature = np.column_stack([heated, heated])
        predicted = Predicted(dataclasses.replace(run, temperature=temperature), run.bend, run.bend)
        remarks = [*remarks_on_coverage(limb, [predicted])]
        assert len(remarks) == len(said)
        for remark, part in zip(remarks, said, strict=True):
            assert part in remark.sentence


def test_a_course_has_even_steps_of_any_samples():
    """5 Hz with a drifting clock, and 20 Hz: the same steps of duty and readings."""
    limb = limb_with(LAWS["linear"])
    levels = PiecewisePolynomial.ZeroOrderHold(
        [0.0, 4.0, 11.0, 20.0], [[0, 0.3, 0, 0], [0, 0, 0.2, 0]]
    )
    levels = later(levels)
    fast = HeatedRun.of(simulate(Limb(limb), levels, sample_rate=20.0))
    slow = HeatedRun.of(simulate(Limb(limb), levels, sample_rate=5.0))
    np.testing.assert_allclose(fast.duty, slow.duty, atol=0.15)
    np.testing.assert_allclose(fast.duty.sum(axis=0), slow.duty.sum(axis=0), atol=0.1)
    at_slow = np.array([np.interp(slow.times, fast.times, v) for v in fast.temperature.T]).T
    np.testing.assert_allclose(at_slow, slow.temperature, atol=0.3)


def test_a_warm_start_is_no_fault_where_a_reading_is_missing():
    readings = np.array([[71.0, 60.0], [np.nan, 58.0]])
    assert not remarks_on_start("the wire", 75.0, AMBIENT, readings)
    (remark,) = remarks_on_start("the wire", 95.0, AMBIENT, readings)
    assert remark.kind == "start"


def test_no_law_is_picked_that_predicts_worse_than_the_mean():
    """The motion bends the other way, as that of another limb."""
    heated, motion = recording_of("linear", "conditioning"), recording_of("linear", "motion_1")
    other = dataclasses.replace(motion, bend_angle=-motion.bend_angle)
    given = {"heated": [heated], "motion": [motion]}
    found = fit_by_prediction([LinearLaw], given, SEGMENT, AMBIENT)
    assert np.rad2deg(found.best.bend_error) < 1.0
    with pytest.raises(CalibrationError, match=r"tell no model: .* misses the bend by \d+°"):
        fit_by_prediction([LinearLaw], given | {"motion": [other]}, SEGMENT, AMBIENT)

"""The estimate of a limb: the filter in its textbook form, sensors that fail, and the observer."""

import copy
import dataclasses

import numpy as np
import pytest
from pydrake.trajectories import PiecewisePolynomial

from controllers import LimbObserver
from controllers import estimator as module
from controllers.estimator import Estimator, pack
from controllers.temperature_supervisor import TemperatureLimiter
from hardware import LimbTwin
from limb_systems import (
    Limb,
    LimbParameters,
    TipTangentSensor,
    simulate,
)
from limb_systems.bend_sensor import roll_bends
from limb_systems.limb_parameters import CalibrationRecord

PERIOD = 0.05
DUTY = np.array([0.15, 0.6])


def linear_limb():
    parameters = LimbParameters()
    segment = parameters.segments[0]
    segment.bend_sensor = TipTangentSensor(gain=1.1, offset=0.02, noise=0.01, drift=0.03)
    segment.wire("left").law.a1, segment.wire("right").law.a3 = -0.1, -0.7
    segment.wire("left").law.beta = 3e-4
    return parameters


def textbook_filter(parameters, duty, readings, bends):
    """Means (K, 9) of [T, V, q, d, p, r] and the last covariance, in the information form.

    All matrices are written down from (4), (6), (7), (11) and the constants of the filter.
    """
    segment, T0 = parameters.segments[0], parameters.ambient_temperature
    laws = [segment.wire(name).law for name in ("left", "right")]
    a1, a2, a3, beta = np.transpose([[law.a1, law.a2, law.a3, law.beta] for law in laws])
    sensor = segment.bend_sensor
    rates = np.block([[np.diag(a1), np.zeros((2, 2))], [-np.diag(a3), np.diag(a3)]])
    step = np.eye(4) + PERIOD * rates + (PERIOD * rates) @ (PERIOD * rates) / 2  # midpoint method
    of_duty = (PERIOD * np.eye(4) + PERIOD**2 / 2 * rates) @ np.vstack(
        [np.diag(a2), 0 * rates[:2, :2]]
    )
    F = np.zeros((9, 9))
    F[:4, :4] = step
    F[:2, 4:6] = PERIOD * np.eye(2)
    decay = np.exp(-PERIOD / np.array([15.0, 15.0, 120.0, np.inf, module.RESIDUAL_TIME]))
    F[4:, 4:] = np.diag(decay)
    bend = (segment.links + 1) / 2 / segment.stiffness * beta * [-1.0, 1.0]
    C = np.zeros((3, 9))
    C[0, 2] = C[1, 3] = 1.0
    C[2] = [*bend, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    R = np.diag([module.READING_NOISE**2, module.READING_NOISE**2, sensor.noise**2])
    x = np.array([*readings[0], *readings[0], 0.0, 0.0, 0.0, 0.0, 0.0])
    unknown = [1.0, 1.0, 1.0, 1.0, 0.5, 0.5, sensor.drift, module.INITIAL_BEND, 0.0]
    P = np.diag(unknown) ** 2
    means = []
    for D, V, phi in zip(duty, readings, bends, strict=True):
        # φ = bend · (T - T0) + d + p + r
        z = [*V, (phi - sensor.offset) / sensor.gain + bend.sum() * T0]
        # r is known at the start, with a covariance that is next to nothing.
        P[8, 8] = max(P[8, 8], 1e-12)
        information = np.linalg.inv(P) + C.T @ np.linalg.inv(R) @ C
        x = np.linalg.solve(information, np.linalg.solve(P, x) + C.T @ np.linalg.solve(R, z))
        means.append(x)
        heating = (0.1 * of_duty[:2] @ D) ** 2 / PERIOD  # after a second, as for the others
        walk = [0.25, 0.25, 0.01, 0.01, 2 / 15, 2 / 15, 2 * sensor.drift**2 / 120]
        walk = PERIOD * np.array([*walk, module.BEND_WALK**2, 0.0])
        walk[:2] += heating
        warmth = x[:2]
        x = F @ x
        x[:4] += (np.eye(4) - step) @ np.full(4, T0) + of_duty @ D
        path = np.abs(bend) @ np.abs(x[:2] - warmth)  # what one wire bends, none takes back
        walk[8] = module.UNKNOWN_BEND_ERROR**2 / module.RESIDUAL_PATH * path
        P = F @ np.linalg.inv(information) @ F.T + np.diag(walk)
    return np.array(means), P


def means_of(estimate):
    """[x, V, q, d, p, r] (M,) of an estimate."""
    names = "heat", "heating_rate", "drift", "lasting", "residual"
    return np.concatenate([getattr(estimate, name) for name in names])


def test_on_a_linear_law_it_is_the_textbook_filter():
    parameters, rng, K = linear_limb(), np.random.default_rng(8), 60
    duty = rng.uniform(0.0, 1.0, (K, 2))
    times = PERIOD * np.arange(K)[:, None]
    readings = 22.0 + [3.0, 6.0] * times + rng.normal(0.0, 0.3, (K, 2))
    bends = 0.05 + 0.02 * times[:, 0] + rng.normal(0.0, 0.01, K)
    filtered, means = Estimator(parameters), []
    estimate = filtered.begin(readings[0], bends[:1])
    for k in range(K):
        estimate = filtered.correct(estimate, readings[k], bends[k : k + 1])
        assert (estimate.unbelieved_time == 0.0).all()
        means.append(means_of(estimate))
        estimate = filtered.predict(estimate, duty[k])
    expected, covariance = textbook_filter(parameters, duty, readings, bends)
    np.testing.assert_allclose(means, expected, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-7, atol=1e-12)


def test_covariance_matches_the_errors_in_space():
    """e' P⁻¹ e of 15 limbs whose errors are as large as the filter's constants say is of χ²."""
    from scipy.stats import chi2  # takes long to import

    parameters, rng = LimbParameters.in_space(links=2), np.random.default_rng(5)
    offsets = -0.02, 0.1
    sensor = parameters.segments[0].bend_sensor = TipTangentSensor(
        offset=offsets[0], offset_e3=offsets[1], roll=0.3
    )
    noise, drift, h = sensor.noise, sensor.drift, PERIOD
    filtered = Estimator(parameters)
    model, W, F = filtered.model, 3, 2
    sizes, times = [W, F, F, F], [module.HEATING_TIME, 120.0, np.inf, module.RESIDUAL_TIME]
    decay = np.exp(-h / np.repeat(times, sizes))
    walk = np.repeat([2 / module.HEATING_TIME, 2 * drift**2 / 120, module.BEND_WALK**2, 0.0], sizes)
    normalized = []
    for _ in range(15):
        heat = model.cold + rng.normal(size=6)
        others = rng.normal(size=W + 3 * F) * np.repeat(
            [0.5, drift, module.INITIAL_BEND, 0.0], sizes
        )
        estimate = filtered.begin(model.cold[:W], np.full(F, np.nan))
        for k in range(60):
            q, d, p, r = np.split(others, [W, W + F, W + 2 * F])
            readings = heat[W:] + module.READING_NOISE * rng.normal(size=W)
            bend = offsets + roll_bends(model.bend_angle(heat) + d + p + r, 0.3)
            bend += noise * rng.normal(size=F)
            estimate = filtered.correct(estimate, readings, bend)
            duty = np.clip(0.4 + 0.4 * np.sin(0.05 * k + np.arange(W) * 2.0), 0.0, 1.0)
            estimate = filtered.predict(estimate, duty)
            heating = rng.normal(size=W) * 0.1 * h * 20.0 * duty
            before, heat = heat, model.step(heat, duty)
            heat[:W] += h * q + heating + 0.5 * np.sqrt(h) * rng.normal(size=W)
            heat[W:] += 0.1 * np.sqrt(h) * rng.normal(size=W)
            path = np.abs(model.bend_by_temperature) @ np.abs(heat - before)[:W]
            walks = h * walk
            walks[-F:] = module.UNKNOWN_BEND_ERROR**2 / module.RESIDUAL_PATH * path
            others = decay * others + np.sqrt(walks) * rng.normal(size=W + 3 * F)
        error = means_of(estimate) - np.concatenate([heat, others])
        normalized.append(error @ np.linalg.solve(estimate.covariance, error))
    low, high = chi2.ppf([0.001, 0.999], 15 * len(error))
    assert low < np.sum(normalized) < high


@pytest.fixture(scope="module")
def limb():
    parameters = LimbParameters()
    parameters.segments[0].links = 2
    return parameters


@pytest.fixture(scope="module")
def recording(limb):
    """Of the model, with noise: the right wire is heated, then the left one."""
    course = PiecewisePolynomial.ZeroOrderHold(
        [0.0, 5.0, 10.0], np.transpose([DUTY, DUTY[::-1], DUTY])
    )
    recorded = simulate(Limb(limb), course, 10.0)
    rng = np.random.default_rng(4)
    noise = {"measured_temperature": 0.2, "bend_angle": 0.005}
    for name, deviation in noise.items():
        values = getattr(recorded, name)
        setattr(recorded, name, values + rng.normal(0.0, deviation, values.shape))
    return recorded


def estimates(limb, recording, spoil=lambda k, V, phi: (V, phi)):
    """Of all samples, from readings that are spoilt."""
    filtered = Estimator(limb)
    vector, found = filtered.nothing, []
    for k in range(len(recording.time)):
        V, phi = spoil(
            k, recording.measured_temperature[:, k].copy(), recording.bend_angle[:, k].copy()
        )
        found.append(filtered.read(vector, V, phi))
        vector = pack(filtered.predict(found[-1], recording.duty[:, k]))
    return found


def test_a_bend_that_is_known_is_no_payload():
    limb = LimbParameters()
    limb.calibration = CalibrationRecord(["rest_angle"], [0.0], [0.002], [[4e-6]])
    estimator = Estimator(limb)
    cold = np.full(2, 25.0)
    known_offset = np.deg2rad([10.0])
    known = estimator.read(estimator.nothing, cold, known_offset, known_offset)
    unloaded = estimator.read(estimator.nothing, cold, np.zeros(1))
    np.testing.assert_array_equal(known.covariance, unloaded.covariance)
    payload = estimator.read(estimator.nothing, cold, known_offset)
    assert np.trace(payload.covariance) > np.trace(unloaded.covariance)


def bends(limb, found):
    model = Estimator(limb).model
    return np.rad2deg([model.bend_angle(estimate.heat) + estimate.offset for estimate in found])[
        :, 0
    ]


FROM = 100  # the sample from which a sensor fails


def from_then_on(bend):
    """A fault of the bend sensor, by what it shows of the bend at samples from `FROM` on."""
    return lambda k, V, phi: (V, bend(k, phi) if k >= FROM else phi)


ABSENT, LYING, JUMPING, STUCK = map(
    from_then_on,
    (
        lambda k, phi: np.full(1, np.nan),
        lambda k, phi: phi + np.deg2rad(40.0),
        lambda k, phi: phi + np.deg2rad(12.0) * (-1) ** k,
        lambda k, phi: np.zeros(1),
    ),
)
# 8° more each second, which no gate for single readings notices
CREEPING = from_then_on(lambda k, phi: phi + np.deg2rad(8.0) * PERIOD * (k - FROM))


def test_a_reading_that_creeps_is_drift_of_a_sensor_unless_the_wires_heat(limb):
    """It creeps by 2° within 20 s, of a limb whose rest angle is known to half a degree."""
    known, half = copy.deepcopy(limb), float(np.deg2rad(0.5))
    known.calibration = CalibrationRecord(["rest_angle"], [0.0], [half], [[half**2]])
    known.calibration.bend_error = 2 * half
    shares = []
    for levels in ([0.0, 0.0], [0.2, 0.5]):
        recording = simulate(Limb(limb), course_of([levels], 20.0), 20.0)
        rate = np.deg2rad(2.0) * PERIOD / 20.0

        def creeping(k, V, phi, rate=rate):
            return V + 0.1 * (-1) ** k, phi + rate * k  # noise: they are not stuck

        last = estimates(known, recording, creeping)[-1]
        assert np.rad2deg(last.offset + last.drift) == pytest.approx([2.0], abs=0.3)
        shares.append((last.drift / (last.offset + last.drift)).item())
    assert shares[0] > 0.5
    assert shares[1] < 0.4


def test_a_sensor_that_drifts_further_than_described_is_reported(limb):
    """By 6° within 10 s. A drift of 1° is described."""
    recording = simulate(Limb(limb), course_of([[0.1, 0.3], [0.3, 0.1]], 20.0), 20.0)
    limb = copy.deepcopy(limb)
    limb.calibration = CalibrationRecord(["rest_angle"], [0.0], [0.01], [[1e-4]], bend_error=0.01)
    for drift, told in ((1.0, 0.0), (6.0, 15.0)):
        drifts = np.deg2rad(drift) * np.minimum(1.0, recording.time / 10.0)
        read = dataclasses.replace(recording, bend_angle=recording.bend_angle + drifts)
        seconds, most = Estimator(limb).unexplained(read)
        assert seconds == pytest.approx(told, abs=1.5)
        if told:
            assert np.rad2deg(most) == pytest.approx(drift, abs=0.5)


def test_a_bend_sensor_that_fails_does_not_move_the_estimate(limb, recording):
    good = estimates(limb, recording)
    assert all(estimate.unbelieved_time[2] == 0.0 for estimate in good)
    for spoil in (ABSENT, LYING, JUMPING, STUCK):
        spoilt = estimates(limb, recording, spoil)
        late = slice(FROM + 11, None)  # it must be stuck for half a second
        assert all(estimate.unbelieved_time[2] > 0.0 for estimate in spoilt[late])
        assert np.abs(bends(limb, spoilt) - bends(limb, good)).max() < 1.5
        heat = [np.array([e.heat[:2] for e in found]) for found in (good, spoilt)]
        assert np.abs(heat[0] - heat[1]).max() < 1.0
        assert spoilt[-1].unbelieved_time[2] == pytest.approx(
            PERIOD * (len(spoilt) - FROM), abs=0.51
        )


def test_a_bend_sensor_that_creeps_is_believed_up_to_20_degrees(limb, recording):
    found = estimates(limb, recording, CREEPING)
    assert found[FROM + 30].unbelieved_time[2] == 0.0
    assert found[-1].unbelieved_time[2] > 1.0
    offsets = np.rad2deg([estimate.offset + estimate.drift for estimate in found])
    assert 10.0 < offsets.max() < 21.0


def test_a_thermocouple_that_freezes_does_not_move_the_estimate(limb, recording):
    """Its wire is heated, while it goes on showing what it did; nor is a wire at rest believed."""

    def frozen(k, V, phi):
        return np.where(
            (k >= FROM) & (np.arange(2) == 0), recording.measured_temperature[0, FROM], V
        ), phi

    found = estimates(limb, recording, frozen)
    missed = missed_heat(recording, found)
    assert np.abs(missed).max() < 6.0
    assert recording.wire_temperature[0, -1] > recording.wire_temperature[0, FROM] + 20.0
    assert found[-1].unbelieved_time[0] > 2.0
    assert found[-1].unbelieved_time[1] == 0.0
    assert all(estimate.unbelieved_time[2] == 0.0 for estimate in found)
    assert found[-1].heating_rate[0] == 0.0  # what it said of this is forgotten
    rested = Estimator(limb)
    estimate = rested.begin(np.full(2, 25.0), np.zeros(1))
    for k in range(45):
        readings = np.array([25.0, 25.0 + 0.1 * (k % 2)])
        estimate = rested.correct(estimate, readings, np.full(1, np.nan))
        estimate = rested.predict(estimate, np.zeros(2))
    assert estimate.unbelieved_time[0] > 0.0
    assert estimate.unbelieved_time[1] == 0.0


def missed_heat(recording, found):
    """By how much T of all wires was overestimated (K, W), °C."""
    return [e.heat[:2] - T for e, T in zip(found, recording.wire_temperature.T, strict=True)]


def test_a_thermocouple_that_reads_too_hot_does_not_wind_up(limb, recording):
    """It raises T to what it reads at most, after a jump only if it stays, and not for longer."""
    limiter = TemperatureLimiter(limb)
    for seconds, rise, most, meanwhile in (
        (2.0, 0.0, 3.0, 3.0),
        (4.5, 0.0, 65.0, 3.0),
        (2.0, 1.0, 70.0, 70.0),  # which climbs within a second, as a wire may
    ):

        def hot(k, V, phi, seconds=seconds, rise=rise):
            t = PERIOD * (k - FROM)
            share = min(1.0, t / rise) if rise else 1.0
            return V + np.array([0.0, 60.0 * share * (0.0 <= t < seconds)]), phi

        found = estimates(limb, recording, hot)
        missed = np.array(missed_heat(recording, found))
        assert missed.max() < most
        assert missed[: FROM + 59].max() < meanwhile
        assert np.abs(missed[-1]).max() < 3.0
        assert missed.min() > -6.0
        assert (missed < -3.0).sum() < 10  # for half a second, when it has jumped back
        assert limiter.caps(found[FROM - 1])[1] > 0.5
        assert limiter.caps(found[FROM + 25])[1] == 0.0  # it acts on the reading at once


def course_of(levels, seconds):
    return PiecewisePolynomial.ZeroOrderHold(
        np.linspace(0.0, seconds, len(levels) + 1), np.transpose([*levels, levels[-1]])
    )


def observed(fed, parameters, recording):
    return fed(
        LimbObserver(parameters),
        {
            "duty": recording.duty.T,
            "measured_temperature": recording.measured_temperature.T,
            "bend_angle": recording.bend_angle.T,
        },
    )


def test_the_observer_knows_the_temperature_of_emulated_wires(fed):
    """Within 3 °C nearly always, although the limb is not calibrated and thermocouples lag."""
    levels = np.random.default_rng(6).uniform(0.0, 0.45, (6, 2))
    recording = simulate(LimbTwin(seed=14, truth=True), course_of(levels, 12.0), 12.0)
    shown = observed(fed, LimbParameters(), recording)
    missed = np.abs(shown.wire_temperature.T - recording.wire_temperature)
    lag = np.abs(recording.measured_temperature - recording.wire_temperature)
    assert np.percentile(lag, 95) > 4.0
    assert np.percentile(missed, 95) < 3.0
    assert np.mean(missed < 2 * shown.temperature_deviation.T) > 0.9


def test_the_observer_finds_a_torque_from_outside(fed):
    """A rest angle of 6° that it does not know is what 2 k 6° / (n + 1) would hold, by (11)."""
    bent, known = LimbParameters(), LimbParameters()
    bent.segments[0].rest_angle = np.deg2rad(6.0)
    recording = simulate(Limb(bent), course_of([[0.2, 0.4], [0.4, 0.2]], 10.0), 10.0)
    shown = observed(fed, known, recording)
    torque = 2 * known.segments[0].stiffness * np.deg2rad(6.0) / (known.segments[0].links + 1)
    assert shown.torque_disturbance[-1, 0] == pytest.approx(torque, rel=0.1)
    explained = shown.bend_angle + shown.sensor_drift
    assert np.rad2deg(np.abs(explained.T - recording.bend_angle))[:, 20:].max() < 0.5
    assert (shown.believed == 1.0).all()


def test_the_observer_says_which_sensor_it_does_not_believe(fed):
    limb = LimbParameters()
    recording = simulate(Limb(limb), course_of([[0.3, 0.5]], 3.0), 3.0)
    spoilt = recording.bend_angle.T.copy()
    spoilt[30:] += np.deg2rad(30.0)
    readings = recording.measured_temperature.T.copy()
    readings[40:, 1] = np.nan
    shown = fed(
        LimbObserver(limb),
        {"duty": recording.duty.T, "measured_temperature": readings, "bend_angle": spoilt},
    )
    np.testing.assert_array_equal(shown.believed[30], [1, 1, 1])
    np.testing.assert_array_equal(shown.believed[31:41], np.tile([1, 1, 0], (10, 1)))
    np.testing.assert_array_equal(shown.believed[41:], np.tile([1, 0, 0], (20, 1)))


def test_observer_predicts_the_highest_temperature_of_the_next_second(fed):
    """Of a wire that heats by 21% more than known, 2.5 °C/s, as a supply of 10% more voltage has
    it, and of one that cools: its own temperature now."""
    known, limb = LimbParameters(), LimbParameters()
    for wire in limb.wires:
        wire.law.a2 *= 1.21
    recording = simulate(Limb(limb), course_of([[0.6, 0.6], [0.0, 0.6]], 6.0), 6.0)
    shown, T = observed(fed, known, recording), recording.wire_temperature
    assert shown.highest_temperature[80, 1] == pytest.approx(T[1, 100], abs=2.0)
    assert shown.highest_temperature[80, 0] == pytest.approx(T[0, 80], abs=1.0)
    assert T[0, 100] < T[0, 80] - 1.0

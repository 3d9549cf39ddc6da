"""Learning over repetitions, on plants that are the reduced model with known errors."""

import copy
import dataclasses

import numpy as np
import pytest

from controllers import Learner, duty_correction
from controllers.duty_correction import (
    CHANGE_COST,
    LEVEL_COST,
    READING_MARGIN,
    DutyCorrection,
    Residuals,
)
from controllers.learner import OVERHEATING_MARGIN, SHARES, RepeatingError, ornstein_uhlenbeck
from controllers.reduced_model import ReducedModel
from limb_systems import HystereticLaw, LimbParameters, Recording, Trajectory
from limb_systems.files.csv_format import FileFormatError
from limb_systems.files.trajectory import PlanCheck

DURATION = 12.0
CHECKED = PlanCheck(largest_defect=0.0, largest_difference_deg=0.0, tolerance_deg=1.0)


def limb(noise_deg=0.5, drift_deg=1.0) -> LimbParameters:
    parameters = LimbParameters()
    sensor = parameters.segments[0].bend_sensor
    sensor.noise, sensor.drift = np.deg2rad([noise_deg, drift_deg]).tolist()
    return parameters


def plan_of(parameters: LimbParameters) -> Trajectory:
    """What the model does under smooth duty, knots at 10 Hz."""
    model = ReducedModel(parameters)
    times = np.arange(0.0, DURATION + 0.01, 0.1)
    phases = np.arange(model.num_wires)
    duty = 0.3 - 0.2 * np.cos(0.8 * np.add.outer(times, phases))
    middles = np.arange(0.025, DURATION, 0.05)
    steps = np.array([np.interp(middles, times, column) for column in duty.T]).T
    heat = model.rollout(model.cold, steps)[::2]
    angles = model.joint_angles(heat)
    states, W = heat[:, : -model.num_wires], model.num_wires
    return Trajectory(
        time=times,
        reference=model.bend_angle(heat).T,
        duty=duty.T,
        joint_state=np.vstack([angles.T, np.gradient(angles, times, axis=0).T]),
        wire_temperature=states[:, :W].T,
        measured_temperature=model.readings(heat).T,
        parameters=parameters,
        check=CHECKED,
        other_wire_state=states[:, W:].T if states.shape[1] > W else None,
    )


class Plant:
    """The reduced model of other parameters, with a sensor and an error that repeats."""

    def __init__(self, parameters, seed=0, disturbance=lambda times: 0 * times):
        self.model, self.random = ReducedModel(parameters), np.random.default_rng(seed)
        self.disturbance = disturbance
        self.start, self.heat = self.model.cold, np.zeros(0)

    def repeat(self, learner, *, offset=0.0, end=DURATION, interrupted="") -> Recording:
        """A repetition with the learned duty, and an offset of the bend, rad."""
        times = np.arange(0.0, end + 0.01, 0.05)
        course = learner.duty_trajectory()
        duty = course.vector_values(times[:-1] + 0.025).T
        self.heat = self.model.rollout(self.start, duty)
        self.bend = self.model.bend_angle(self.heat) + self.disturbance(times)[:, None] + offset
        bend = self.bend.copy()
        limb = self.model.limb.parameters
        for column, segment in zip(bend.T, self.model.limb.layout.bend_segment, strict=True):
            sensor = limb.segments[segment].bend_sensor
            drift = self.random.multivariate_normal(
                0 * times, ornstein_uhlenbeck(times, sensor.drift, 120)
            )
            column += drift + sensor.noise * self.random.normal(size=len(times))
        return Recording(
            time=times,
            duty=course.vector_values(times),
            measured_temperature=self.model.readings(self.heat).T,
            bend_angle=bend.T,
            parameters=self.model.limb.parameters,
            source="reduced model",
            sample_rate=20.0,
            interrupted=interrupted,
        )

    def error(self, learner) -> float:
        """Mean of |φ* - φ| of the last repetition, without the sensor's errors, degrees."""
        planned = learner.trajectory.bend_angle_at(np.arange(len(self.bend)) * 0.05)
        return float(np.rad2deg(np.abs(planned.T - self.bend).mean()))


def ripple(times):
    """A repeating error of 3°, none at the start."""
    return np.deg2rad(3.0) * np.sin(0.5 * times) ** 2


def test_gains_and_random_errors_are_estimated_from_changes():
    """Of 40 repetitions whose changes the limb has 1.4 times and, but for 30%, 0.8 times."""
    random, times = np.random.default_rng(0), np.arange(0.0, 20.0, 0.2)
    noise = np.deg2rad(0.1)
    covariance = ornstein_uhlenbeck(times, 0.1, 2.0)
    part = RepeatingError(times, covariance, np.eye(100), noise**2 * np.eye(100))
    phases = random.uniform(0, 7, (40, 1, 2))
    bend_changes = np.deg2rad(3.0) * np.sin(times[:, None] * [0.5, 0.8] + phases)
    spread = [ornstein_uhlenbeck(times, size, 2.0) for size in np.linalg.norm(bend_changes, axis=2)]
    wrong = [random.multivariate_normal(0 * times, 0.3**2 * matrix) for matrix in spread]
    error = np.deg2rad(2.0) * np.cos(0.3 * times)
    shown = error + bend_changes @ [0.4, -0.2] + wrong + noise * random.normal(size=(40, 100))
    found = part.estimate(shown, bend_changes, 0.3)
    np.testing.assert_allclose(found.gains, [1.4, 0.8], atol=0.05)
    np.testing.assert_allclose(found.error, error, atol=np.deg2rad(0.4))
    likely = sum(
        part.likelihoods(part.estimate(shown[:j], bend_changes[:j], 0.3), shown[j], bend_changes[j])
        for j in range(1, 6)
    )
    assert SHARES[np.argmax(likely)] == pytest.approx(0.3, rel=0.35)


def test_a_limb_changes_a_little_between_repetitions_also_with_a_sensor_that_does_not():
    """0.1° of the same duty is likely; 1° is not."""
    learner = Learner(plan_of(limb(0.0, 0.0)))
    (regression,) = learner._bend_regressions
    nodes = learner.nodes
    none = np.zeros((1, len(nodes), 2))
    estimate = regression.estimate(np.zeros((1, len(nodes))), none, 0.3)
    likelihoods = [
        regression.likelihoods(estimate, np.full(len(nodes), np.deg2rad(offset)), none[0]).max()
        for offset in (0.0, 0.1, 1.0)
    ]
    assert likelihoods[1] > likelihoods[0] - 2.0
    assert likelihoods[2] < likelihoods[0] - 20.0


def test_correction_is_that_of_least_squares_where_no_bound_is_active():
    """With slopes by differences, in one dense system; half of each wire's change is doubted."""
    plan = plan_of(limb())
    program, start = DutyCorrection(plan), DutyCorrection(plan).start()
    nodes, W = program.nodes, 2
    missing = 1e-5 * np.sin(0.5 * nodes)[:, None]  # rad; so little that all is linear
    none = np.zeros((len(nodes), W))
    doubt = np.full(1, 0.5)
    errors = Residuals(-missing, none, none, none, np.ones((1, W)), doubt)
    found = program.improve(program.none, start, errors)

    moved, step = np.eye(none.size).reshape(-1, *none.shape), 1e-4
    shares = np.array([np.interp(program.middles, nodes, one) for one in np.eye(len(nodes))]).T
    planned = program.steps(program.none)
    duty = planned[:, None] + step * np.einsum("lk,bkw->lbw", shares, moved)
    model = program.model
    bend = model.bend_angle(program.rollout(np.tile(start, (none.size, 1)), duty))[..., 0]
    base = model.bend_angle(program.rollout(start, planned))
    G = np.rad2deg(bend - base) / step
    differences = np.kron(np.diff(np.eye(len(nodes)), axis=0), np.eye(W))
    weights = LEVEL_COST * np.eye(none.size) + CHANGE_COST * differences.T @ differences
    missed = np.rad2deg(missing + program.reference - base)[:, 0]
    for of_wire in np.tile(np.eye(W), len(nodes)):
        weights += doubt**2 * (G * of_wire).T @ (G * of_wire)
    exact = np.linalg.solve(G.T @ G + weights, G.T @ missed)
    assert np.abs(exact).max() > 1e-5
    np.testing.assert_allclose(found.ravel(), exact, atol=1e-9)


def wrong(parameters: LimbParameters) -> LimbParameters:
    """A limb of other torque and heat than the model's."""
    other = copy.deepcopy(parameters)
    for index, wire in enumerate(other.wires):
        wire.law.a2 *= 1.1 if index % 2 else 0.95
        wire.law.a1 *= 0.93 if index % 2 else 1.05
    for segment in other.segments:
        segment.stiffness *= 0.9
    return other


def hysteretic() -> LimbParameters:
    parameters = limb()
    for wire in parameters.segments[0].wires:
        wire.law = HystereticLaw()
    return parameters


def test_error_falls_on_limbs_that_differ_from_their_model(two_segments):
    for known, repetitions in (
        (hysteretic(), 3),
        (two_segments, 2),
        (LimbParameters.in_space(links=2), 2),
    ):
        learner, plant = Learner(plan_of(known)), Plant(wrong(known))
        errors = []
        for _ in range(repetitions):
            repetition = learner.update(plant.repeat(learner))
            errors.append(plant.error(learner))
        assert errors[0] > 1.0
        assert errors[-1] < 0.5 * errors[0]
        assert max(np.diff(errors)) < 0.0
        # The sensor drifts; the estimate of the distance is nearer to the truth than the reading.
        distances = [repetition.estimated_distance, repetition.reference_distance]
        estimated, read = np.abs(np.rad2deg(distances) - errors[-1])
        assert estimated < 0.5 * read


def test_the_mean_distance_counts_where_a_reference_is_out_of_reach(monkeypatch):
    """Squares would let a limb leave all of it for what is farthest away."""
    parameters = limb()
    plan = plan_of(parameters)
    far = np.deg2rad(60.0) * (np.abs(plan.time - 6.0) < 0.6)
    plan = dataclasses.replace(plan, reference=plan.reference + far)
    distances = []
    for near in (duty_correction.HUBER_WIDTH, 1e4):
        monkeypatch.setattr(duty_correction, "HUBER_WIDTH", near)
        program = DutyCorrection(plan)
        start, none = program.start(), program.none
        errors = Residuals(0 * program.reference, none, none, none, np.ones((1, 2)), np.zeros(1))
        found = program.none
        for _ in range(3):
            found = program.improve(found, start, errors)
        expected = program.expected_bend(found, start, errors)
        distances.append(np.rad2deg(program.distance(expected)))
    assert distances[0] < distances[1] - 0.5


def test_bounds_hold_also_where_the_model_is_too_cold():
    parameters = limb(0.0, 0.0)
    plan = plan_of(parameters)
    warmest = plan.wire_temperature.max()
    plan.parameters.temperature_limits.maximum = float(warmest)
    plan.parameters.total_duty = 0.96
    hot = copy.deepcopy(parameters)
    for wire in hot.segments[0].wires:
        wire.law.a2 *= 1.15
    learner, plant = Learner(plan), Plant(hot, disturbance=lambda t: -8 * ripple(t))
    learner.update(plant.repeat(learner))
    first = plant.model.temperatures(plant.heat).max()
    assert first > warmest + 5.0
    for _ in range(2):
        learner.update(plant.repeat(learner))
        duty = learner.duty_trajectory().vector_values(np.linspace(0.0, DURATION, 997))
        assert duty.min() >= 0.0
        assert duty.max() <= 1.0
        assert duty.sum(axis=0).max() < 0.96 + 1e-6
    assert plant.model.temperatures(plant.heat).max() < warmest + 1.0
    assert learner.expected_error > np.deg2rad(0.3)  # what the bounds leave
    planned, expected = plan.bend_angle_at(learner.nodes).T, learner.expected_bend_angle()
    np.testing.assert_allclose(np.abs(planned - expected).mean(), learner.expected_error)


def test_wires_stay_warm_also_where_the_model_is_too_warm():
    parameters, times = limb(0.0, 0.0), np.arange(0.0, DURATION + 0.01, 0.05)
    plan, cool = plan_of(parameters), copy.deepcopy(parameters)
    limits, late = plan.parameters.temperature_limits, times > 5.0
    limits.warm_up_time = 5.0
    limits.warm = float(plan.wire_temperature[:, plan.time > 5.0].min())
    for wire in cool.segments[0].wires:
        wire.law.a2 *= 0.85
    learner, plant, coolest = Learner(plan), Plant(cool), []
    for _ in range(3):
        learner.update(plant.repeat(learner))
        coolest.append(plant.model.temperatures(plant.heat)[late].min())
    assert coolest[0] < limits.warm - 4.0
    assert coolest[-1] > limits.warm - 1.5


@pytest.mark.parametrize("identical", [True, False])
def test_worse_repetitions_are_undone_and_steps_of_another_duty_get_shorter(identical):
    parameters = limb(0.1, 0.1)
    learner, plant = Learner(plan_of(parameters)), Plant(parameters, disturbance=ripple)
    for _ in range(2):
        assert not learner.update(plant.repeat(learner)).remark
    best = learner.repetitions[1].correction
    if identical:
        learner.correction = best
    plant.disturbance = lambda times: -2 * ripple(times)
    worse = learner.update(plant.repeat(learner))
    assert "farther from the reference than the sensor's errors explain" in worse.remark
    assert learner.best == 1
    # The next one begins at the best one and leads as far as with the same knowledge, or half.
    step, errors = learner.correction - best, learner._belief.errors
    whole = learner._program.improve(best, learner._start, errors) - best
    np.testing.assert_allclose(step, (1.0 if identical else 0.5) * whole, atol=1e-12)


def test_first_repetition_that_was_too_hot_lowers_the_bounds():
    parameters = limb(0.1, 0.1)
    plan = plan_of(parameters)
    warmest = float(plan.measured_temperature[:, :91].max())
    plan.parameters.temperature_limits.measured_maximum = warmest
    learner, plant = Learner(plan), Plant(parameters)
    learner.update(plant.repeat(learner, end=9.0, interrupted="too hot"))
    assert np.abs(learner.correction).max() > 0.01
    plant.repeat(learner)
    readings = plant.model.readings(plant.heat)
    assert readings.max() < warmest - READING_MARGIN - OVERHEATING_MARGIN + 0.5


def test_a_loaded_learner_continues_identically(tmp_path):
    parameters = limb()
    learner, plant = Learner(plan_of(parameters)), Plant(wrong(parameters))
    learner.update(plant.repeat(learner))
    learner.update(plant.repeat(learner, end=5.0, interrupted="ended"))
    learner.save(tmp_path / "learning.txt")
    again = Learner.load(tmp_path / "learning.txt")
    np.testing.assert_array_equal(again.correction, learner.correction)
    recording = plant.repeat(learner)
    assert again.update(recording).mean_error == learner.update(recording).mean_error
    np.testing.assert_array_equal(again.correction, learner.correction)
    assert again.finished == learner.finished
    assert [r.interrupted for r in again.repetitions] == ["", "ended", ""]
    learner.save(tmp_path / "one.txt")
    again.save(tmp_path / "other.txt")
    assert (tmp_path / "one.txt").read_bytes() == (tmp_path / "other.txt").read_bytes()


def test_files_that_are_damaged_are_refused_in_a_sentence(tmp_path):
    path = tmp_path / "learning.txt"
    Learner(plan_of(limb())).save(path)
    saved = path.read_text()
    for text, sentence in (
        ("", "its first line is not"),
        (saved.replace("format 7", "format 6", 1), "has format 6, but .* reads format 7; learn"),
        (saved[:-100], "truncated or was changed"),
        (saved.replace("0.3", "0.4", 1), "truncated or was changed"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=f"^{path}: .*{sentence}"):
            Learner.load(path)

"""Gaits against Drake's plant of the robot, closed forms, and figures of a walker that works."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces

from limb_systems import CoupledLaw, LimbModel, LimbParameters, SegmentParameters, simulate
from limb_systems.limb_parameters import CalibrationRecord
from planners.transcription.solving import PlanningError
from walking import Gait, GaitVariation, Robot, RobotLimb, RobotParameters, add_robot, plan_gait
from walking.course import check_course
from walking.gait_planning import _infeasibility_reason, standing_start
from walking.gait_program import STEADINESS, Course, GaitProgram, is_calibrated
from walking.robot_parameters import walking_limb
from walking.schedules import parse_schedule
from walking.standing import FrictionGain, Stability, make_balance
from walking.walker import Walker

from .conftest import contacts_of_intervals, with_quick_wires

VELOCITIES = JacobianWrtVariable.kV


def plant_of(robot: RobotParameters) -> MultibodyPlant:
    plant = MultibodyPlant(0.0)
    robot = RobotParameters.of(robot)
    gravity, robot.ground, robot.gravity = robot.world_gravity, None, [0.0, 0.0, 0.0]
    add_robot(plant, robot)
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    return plant


def odd_robot() -> RobotParameters:
    """A robot of three limbs, none like another, with feet that weigh, up a slope."""
    robot = RobotParameters()
    robot.feet.mass, robot.ground.slope = 2e-3, 0.2
    segments = [SegmentParameters(links=2, length=0.04, mass=0.01, rest_angle=0.3)]
    segments += [SegmentParameters(links=3, length=0.03, mass=0.006, centred_joints=True)]
    side = RobotLimb(
        "side", position=[0.0, 0.02, 0.01], parameters=LimbParameters(segments=segments)
    )
    side.e1, side.e2 = [0.6, 0.0, -0.8], [-0.8, 0.0, -0.6]
    side.parameters.payload = 3e-3
    robot.limbs[1].parameters.segments[0].centred_joints = True
    robot.limbs.append(side)
    return robot


def test_potential_and_feet_match_drakes_plant():
    robot, plant = odd_robot(), plant_of(odd_robot())
    planar, context = Walker(robot), plant.CreateDefaultContext()
    rng = np.random.default_rng(1)
    offset = None
    for y in rng.normal(0.0, 0.5, (3, plant.num_positions())):
        plant.SetPositions(context, y)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        gradient = -plant.CalcGeneralizedForces(context, forces)
        potential, slope = planar.potential.first(y)
        np.testing.assert_allclose(slope[0], gradient, atol=1e-12)
        missed = potential[0] - plant.CalcPotentialEnergy(context)
        offset = missed if offset is None else offset
        assert missed == pytest.approx(offset, abs=1e-12)
        jacobians = planar.feet_jacobian(y)
        for limb, place, jacobian in zip(robot.limbs, planar.feet(y), jacobians, strict=True):
            foot, world = plant.GetFrameByName(f"{limb.name}_foot"), plant.world_frame()
            of_foot = plant.CalcJacobianSpatialVelocity(
                context, VELOCITIES, foot, np.zeros(3), world, world
            )
            assert place[1] == pytest.approx(foot.CalcPoseInWorld(context).translation()[2])
            # Without slip, the lowest point of the sphere is at rest
            np.testing.assert_allclose(
                jacobian, [of_foot[3] - planar.radius * of_foot[1], of_foot[5]], atol=1e-12
            )


def in_the_plane(law: CoupledLaw | None = None) -> RobotParameters:
    robot = RobotParameters()
    for wire in robot.as_single_limb.wires:
        wire.law = law or wire.law
    return robot


COUPLED = CoupledLaw(heating_drop=0.1, stress_shift=6.0, creep_share=0.1)


@pytest.mark.parametrize(
    ("robot", "schedule", "course", "objective"),
    [
        (in_the_plane(), "fs ss sl ss sb ss", Course(), "energy"),
        (in_the_plane(COUPLED), "fs ss sl ss sb ss", Course(), "speed"),
        (RobotParameters.in_space(3), "dss sss sls ssd", Course(turn=0.3), "speed"),
        (RobotParameters.in_space(3), "dss sss sls ssd", Course(turn=np.inf), "energy"),
    ],
)
def test_derivatives_of_all_blocks(robot, schedule, course, objective):
    F = len(robot.limbs)
    schedule = parse_schedule(schedule, F)
    intervals = [2, *[1] * (len(schedule) - 1)]
    program = GaitProgram(robot, schedule, intervals, objective, course=course)
    scales = np.ones(program.prog.num_vars())
    for index, scale in program.prog.GetVariableScaling().items():
        scales[index] = scale
    rng = np.random.default_rng(2)
    x = standing_start(program) + 0.1 * scales * rng.normal(size=len(scales))
    away = scales * rng.normal(size=len(scales))

    def jacobian(block, x):
        places = block.rows, block.columns
        return scipy.sparse.csr_matrix((block.jacobian(x), places), (len(block.lower), len(x)))

    for number, block in enumerate([*program.blocks, *filter(None, [program.sliding])]):
        name = f"block {number}"
        slope = (block.evaluate(x + 1e-6 * away) - block.evaluate(x - 1e-6 * away)) / 2e-6
        found = jacobian(block, x) @ away
        np.testing.assert_allclose(found, slope, atol=1e-7 * abs(slope).max(), err_msg=name)
        weights = rng.normal(size=len(block.lower))
        rows, columns = block.hessian_rows, block.hessian_columns
        hessian = scipy.sparse.csr_matrix(
            (block.hessian(x, weights), (np.maximum(rows, columns), np.minimum(rows, columns))),
            (len(x), len(x)),
        )
        found = scales * (hessian @ away + scipy.sparse.tril(hessian, -1).T @ away)
        ahead, behind = (jacobian(block, x + step * away).T @ weights for step in (1e-6, -1e-6))
        change = scales * (ahead - behind) / 2e-6
        np.testing.assert_allclose(found, change, atol=2e-6 * abs(change).max(), err_msg=name)


def test_pivots_are_positive_where_the_stiffness_is():
    robot = RobotParameters()
    planar, wires = Walker(robot), LimbModel.of(robot.as_single_limb).wires
    rng = np.random.default_rng(3)
    stable = []
    for load in rng.uniform(0.0, 3.0, 60):
        y = rng.normal(0.0, 0.2, len(planar.stiffness))
        forces = load * np.array([rng.uniform(-0.3, 0.3), 1.0, rng.uniform(-0.3, 0.3), 1.0])
        held = np.array([[rng.integers(2), 1.0], [1.0, 1.0]])
        standing = Stability(planar, wires, held)
        point = np.concatenate([y, wires.cold_states, forces, np.zeros(2)])
        stable.append(np.linalg.eigvalsh(standing.stiffness(point))[0] > 0)
        assert (standing.values(point)[:-2] > 0).all() == stable[-1]
    assert 0.2 < np.mean(stable) < 0.8


def three_limbs() -> RobotParameters:
    robot = RobotParameters()
    limbs = {"rear": -0.045, "middle": 0.0, "front": 0.045}
    robot.limbs = [
        RobotLimb(name, position=[x, 0.0, 0.0], parameters=walking_limb())
        for name, x in limbs.items()
    ]
    robot.body.length = 0.1
    return robot


def test_load_and_friction_by_balance_where_the_ground_rises_and_a_foot_is_dragged():
    robot = three_limbs()
    planar, wires, mu = Walker(robot), LimbModel.of(robot.as_single_limb).wires, 0.3
    held = np.array([[[1.0, 1.0], [1.0, 1.0], [0.0, 1.0]]])  # the front foot slides
    standing, balance_at = Stability(planar, wires, held), make_balance(planar, wires)
    d = len(planar.stiffness)
    temperatures = 25.0 + np.array([20.0, 0.0, 0.0, 30.0, 10.0, 0.0])

    def stood(rise: np.ndarray, drag: float, y: np.ndarray, place: np.ndarray):
        """y and the loads in balance on ground that gives way, sticking feet held at places."""
        for _ in range(60):
            forces = -1e4 * (planar.feet(y) - np.column_stack([place, planar.radius + rise]))
            forces[2, 0] = -drag
            point = np.concatenate([y, temperatures, forces.ravel(), np.zeros(3)])
            balance = balance_at.values(point[None])[0, :d]
            if np.abs(balance).max() < 1e-12:
                break
            step = np.linalg.solve(standing.stiffness(point[None])[0], balance)
            y = y - step / max(1.0, np.abs(step).max() / 0.05)
        assert np.abs(balance).max() < 1e-9
        return y, forces, point

    start = planar.rest.copy()
    start[1] = 0.0605
    place = planar.feet(start)[:, 0]
    y, _, point = stood(np.zeros(3), 0.02, start, place)
    gain = FrictionGain(planar, wires, held, np.array([[0.0, 0.0, mu]])).values(point[None])[0, 0]
    dragged = [stood(np.zeros(3), 0.02 + step, y, place)[1][2, 1] for step in (-1e-4, 1e-4)]
    assert gain == pytest.approx(mu * (dragged[1] - dragged[0]) / 2e-4, rel=1e-3)
    stiffnesses = 1000.0 * np.sinh(standing.values(point[None])[0, -3:])
    for foot, expected in enumerate(stiffnesses):
        rise = 1e-7 * np.eye(3)[foot]
        loads = [stood(sign * rise, 0.02, y, place)[1][foot, 1] for sign in (-1, 1)]
        assert expected == pytest.approx((loads[1] - loads[0]) / 2e-7, rel=1e-3)
        assert expected > 100.0  # with two feet, loads do not depend on heights


@pytest.fixture(scope="module")
def coarse() -> Gait:
    """The gait of the crawler on few knots."""
    return plan_gait(check=False, intervals=8)


@pytest.fixture(scope="module", params=[0.3, pytest.param(0.6, marks=pytest.mark.whole)])
def gait(request) -> Gait:
    robot = RobotParameters()
    robot.ground.friction = request.param
    return plan_gait(robot, check=False)


def test_crawler_is_as_fast_as_a_hand_made_gait(gait):
    assert gait.speed >= {0.3: 1.7e-3, 0.6: 1.4e-3}[gait.robot.ground.friction]
    assert gait.check.iterations <= 100
    assert gait.check.violation <= 1e-6


def test_pitch_is_as_stiff_as_asked_for(gait):
    """The stiffness that turning the body meets while all else gives way, by its inverse."""
    planar, wires = Walker(gait.robot), LimbModel.of(gait.parameters).wires
    sticks = contacts_of_intervals(gait) == "stick"
    stuck = sticks & np.roll(sticks, 1, axis=0)
    standing = Stability(planar, wires, np.stack([stuck, np.ones_like(stuck)], axis=-1) * 1.0)
    y = np.vstack([gait.body_pose, gait.joint_angles])
    points = np.vstack([y, gait.wire_states, gait.contact_force, 0 * gait.contact_force[:2]])
    pitch = 1 / np.linalg.inv(standing.stiffness(points.T[:-1]))[:, 2, 2]
    assert pitch.min() == pytest.approx(STEADINESS * 0.49 * 0.06, rel=2e-3)


@pytest.mark.whole
def test_gait_has_the_largest_feasible_steadiness():
    gait = plan_gait(check=False, steadiness=1000.0, intervals=8)
    assert gait.check.steadiness in (125.0, 250.0, 500.0)
    assert "as steady as asked for, 1000" in gait.check.remark


@pytest.fixture
def plan_with_strides(coarse, monkeypatch):
    """Return a function that plans from `coarse`, and takes strides from a function of the gait."""

    def plan(check_strides, simulated_strides) -> Gait:
        def check_gait(gait, spread):
            simulation = GaitVariation("", check_strides(gait))
            return dataclasses.replace(
                gait, check=dataclasses.replace(gait.check, simulation=simulation)
            )

        def simulate_gait(gait, *_):
            return GaitVariation("", simulated_strides(gait))

        monkeypatch.setattr("walking.gait_planning._plan_course", lambda *_: coarse)
        monkeypatch.setattr("walking.gait_planning.check_gait", check_gait)
        monkeypatch.setattr("walking.gait_planning.simulate_gait", simulate_gait)
        return plan_gait(intervals=8)

    return plan


def test_a_gait_that_fails_its_check_is_planned_steadier(plan_with_strides):
    gait = plan_with_strides(
        lambda gait: [0.9 if gait.check.steadiness < 40 else 1.0], lambda gait: [1.0, 1.0]
    )
    assert gait.passed
    assert gait.check.steadiness == 2 * STEADINESS
    assert "a stride is 90.0% of the planned one" in gait.check.remark


def test_a_gait_is_planned_on_denser_knots_until_it_walks_as_planned(coarse, plan_with_strides):
    gait = plan_with_strides(
        lambda gait: [1.0], lambda gait: [0.9, 0.97 if len(gait.time) < 17 else 0.995]
    )
    assert gait.intervals == [2 * number for number in coarse.intervals]
    assert gait.passed  # with its constraints
    assert gait.check.iterations < coarse.check.iterations  # as it begins from the coarse one


def test_a_margin_leaves_room_for_feedback_that_distrusts_the_lag_of_readings():
    gait = plan_gait(temperature_margin=5.0, check=False, intervals=8)
    T, V = gait.wire_temperature, gait.measured_temperature
    assert T.max() <= 95.0 + 1e-4
    assert (T + (T - V)).max() == pytest.approx(97.0, abs=1e-3)


def test_limbs_of_one_wire_reach_no_two_places():
    robot = RobotParameters()
    for limb in robot.limbs:
        del limb.parameters.segments[0].wires[1:]
    check_course(robot, Course())
    with pytest.raises(PlanningError, match=r"the feet are at most 0 mm apart"):
        check_course(robot, Course(stride=0.01))


def test_error_gives_the_reason_for_a_missing_gait():
    together = RobotParameters()
    for limb in together.limbs:
        limb.position = [0.0, 0.0, 0.0]
    narrow = RobotParameters.in_space(4)
    for limb in narrow.limbs:
        limb.position = [0.5 * limb.position[0], 0.4 * limb.position[1], limb.position[2]]
        limb.parameters.calibration = CalibrationRecord([], [], [], [])
    for robot, schedule, margin, words in (
        (together, "fs ss sf ss", 0.0, "all feet are within 0.0 mm of each other"),
        (RobotParameters(), "fs ss sf ss", 74.0, "74 °C below T_max are too cold"),
        (narrow, "dsss sdss ssds sssd", 5.0, "the feet stand too close together, for a robot"),
    ):
        phases = parse_schedule(schedule, len(robot.limbs))
        program = partial(GaitProgram, robot, phases, [2] * 4, temperature_margin=margin)
        assert words in _infeasibility_reason(program)


@pytest.mark.parametrize(
    ("is_feasible", "words"),
    [
        (lambda program: program.robot.ground.friction < 0.1, "friction does not work one way"),
        (lambda program: np.isinf(program.sticking_share), "more of the friction than 0.7"),
        (lambda program: np.isinf(program.steadiness), "the limbs are too soft"),
        (lambda program: program.temperature_margin < 0.0, "the wires are too weak, as it"),
        # Loads and places of feet are bounded by calibration in space alone.
        (lambda program: not is_calibrated(program.robot), "no single limit"),
    ],
)
def test_error_names_the_limit_without_which_there_is_a_gait(monkeypatch, is_feasible, words):
    def solve(program, max_time):
        if not is_feasible(program):
            raise PlanningError("none")

    monkeypatch.setattr("walking.gait_planning._solve", solve)
    robot = RobotParameters()
    for limb in robot.limbs:
        limb.parameters.calibration = CalibrationRecord([], [], [], [])
    schedule = parse_schedule("fs ss sf ss", 2)
    program = partial(GaitProgram, robot, schedule, [2] * 4, sticking_share=0.7)
    assert words in _infeasibility_reason(program)


def test_gait_is_in_balance_by_drakes_inverse_dynamics(gait):
    """Gravity, springs, forces at the feet and torques of the wires, and nothing else."""
    plant, wires = plant_of(gait.robot), LimbModel.of(gait.parameters).wires
    context, load, radius = plant.CreateDefaultContext(), 0.49, gait.robot.feet.radius
    for k in range(len(gait.time)):
        plant.SetPositions(context, np.append(gait.body_pose[:, k], gait.joint_angles[:, k]))
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        for limb, (along, normal) in zip(
            gait.robot.limbs, gait.contact_force[:, k].reshape(-1, 2), strict=True
        ):
            turning = [0.0, -radius * along, 0.0]  # of a force at the foot's lowest point
            foot = plant.GetBodyByName(f"{limb.name}_foot")
            foot.AddInForceInWorld(context, SpatialForce(turning, [along, 0.0, normal]), forces)
        needed = plant.CalcInverseDynamics(context, np.zeros(plant.num_velocities()), forces)
        needed[3:] -= wires.forces(gait.wire_states[:, k], gait.joint_angles[:, k])
        scaled = np.abs(needed) / load / np.append([1.0, 1.0], np.full(len(needed) - 2, 0.06))
        assert scaled.max() <= 1e-6


def test_gait_repeats_with_its_heat_and_its_feet(gait):
    """Heat by its exact solution, feet and friction in each interval, also that to the start."""
    assert gait.body_pose[0, -1] - gait.body_pose[0, 0] == pytest.approx(gait.stride)
    for signal in (gait.wire_temperature, gait.joint_angles, gait.contact_force):
        np.testing.assert_array_equal(signal[:, 0], signal[:, -1])
    law, ambient = gait.robot.limbs[0].parameters.wires[0].law, 25.0
    decay = np.exp(law.a1 * np.diff(gait.time))
    settled = ambient - law.a2 / law.a1 * gait.duty[:, :-1]
    temperature = settled + (gait.wire_temperature[:, :-1] - settled) * decay
    np.testing.assert_allclose(temperature, gait.wire_temperature[:, 1:], atol=1e-3)
    assert gait.wire_temperature.max() <= 100.0 + 1e-6
    assert gait.duty.min() >= 0
    assert gait.duty.sum(axis=0).max() <= gait.robot.total_duty + 1e-9

    planar, mu = Walker(gait.robot), gait.robot.ground.friction
    travel, heights = np.moveaxis(
        planar.feet(np.vstack([gait.body_pose, gait.joint_angles]).T), -1, 0
    )
    along, normal = gait.contact_force.T.reshape(len(gait.time), -1, 2).T
    np.testing.assert_allclose(heights, planar.radius - normal.T / 1e4, atol=1e-9)
    sliding = contacts_of_intervals(gait) == "slide_forward"
    steps = np.diff(travel, axis=0)
    assert (np.abs(steps[~sliding]) < 1e-9).all()
    assert (steps[sliding] > -1e-9).all()
    np.testing.assert_allclose(steps.sum(axis=0), gait.stride)  # both feet go as far as the body
    slides = (sliding | np.roll(sliding, 1, axis=0)).T
    used = along[:, :-1] / normal[:, :-1]
    np.testing.assert_allclose(used[slides], -mu, atol=1e-7)
    assert np.abs(used[~slides]).max() <= 0.8 * mu + 1e-7
    assert normal.min() >= 0.05 * 0.49


@pytest.mark.whole
def test_speed_is_in_proportion_to_cooling():
    """With a1, time stretches; where less duty will do, a2 does not count."""
    periods, strides = [], []
    for share, heating in ((1.0, 1.0), (0.25, 1.0)):
        robot = RobotParameters()
        for wire in robot.as_single_limb.wires:
            wire.law.a1, wire.law.a2 = share * wire.law.a1, heating * wire.law.a2
        gait = plan_gait(robot, check=False, intervals=8)
        periods.append(share * gait.period)
        strides.append(gait.stride)
    np.testing.assert_allclose(periods, periods[0], rtol=1e-3)
    np.testing.assert_allclose(strides, strides[0], rtol=1e-3)


def test_gait_minimizes_the_requested_objective(coarse):
    """Heat by distance is least where it is asked for, and speed where that is, or nothing."""
    frugal = plan_gait(objective="energy", intervals=8, check=False)

    def distance_by_heat(gait: Gait) -> float:
        return gait.stride / float(np.diff(gait.time) @ gait.duty[:, :-1].sum(axis=0))

    assert coarse.speed > 1.5 * frugal.speed
    assert distance_by_heat(frugal) > 1.2 * distance_by_heat(coarse)


@pytest.mark.whole
def test_diagonal_pairs_lift_their_feet_clear_of_the_ground_in_drake():
    """A robot with two pairs of limbs, in the order around its body."""
    corners = {"rear_left": -1, "front_left": 1, "front_right": 1, "rear_right": -1}
    limbs = [
        RobotLimb(name, position=[0.03 * x, 0.0, 0.0], parameters=walking_limb())
        for name, x in corners.items()
    ]
    robot = with_quick_wires(RobotParameters(limbs=limbs), 4.0)
    schedule = parse_schedule("lsls ssss slsl ssss", 4)
    gait = plan_gait(robot, schedule=schedule, intervals=12, check=False)
    swing = gait.phases[1].start
    recording = simulate(
        Robot(robot),
        gait.duty_trajectory(),
        swing,
        initial_state=gait.initial_state,
        sample_rate=100,
    )
    # Before, it starts from rest; after, contact gives way, so that feet land a little early.
    within = (recording.time > 0.2 * swing) & (recording.time < 0.9 * swing)
    loads = recording.contact_force[1::2, within]
    planar = Walker(robot)
    assert np.all(loads[::2] == 0)
    assert loads.sum(axis=0).mean() == pytest.approx(-planar.weight[2], rel=0.01)
    joints = recording.joint_state[: robot.as_single_limb.num_joints]
    feet = planar.feet(np.vstack([recording.body_pose, joints])[:, within].T)
    lifted = feet[:, ::2, 1] - planar.radius
    assert lifted.min() > 0.1e-3
    assert lifted.max() > 1e-3
    landing = np.argmin(np.abs(gait.time - swing))
    assert recording.body_pose[0, -1] == pytest.approx(gait.body_pose[0, landing], rel=0.05)

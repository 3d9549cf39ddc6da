"""Gaits in space: mechanics against Drake's plant, walks with contact, requests, and the way."""

import copy
import dataclasses
import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import EventStatus

from limb_systems import HystereticLaw, LimbError, LimbModel, Recording
from limb_systems.files.output import OutputError
from limb_systems.limb_parameters import CalibrationRecord
from planners import PlanningError
from planners.transcription.ipopt import bounds_of_variables
from soft_limb.command import main
from walking import (
    Gait,
    GaitFeedback,
    GaitVariation,
    RobotParameters,
    Wayfinder,
    add_robot,
    gait_planning,
    plan_gait,
)
from walking.course import Course
from walking.gait import STRIDE_TOLERANCE_IN_SPACE, rotate_to_heading
from walking.gait_check import simulate_gait, variations, warp_pattern
from walking.gait_planning import _solve_with_gradual_turns
from walking.gait_program import MIN_STANCE_STIFFNESS, GaitProgram, default_sticking_share
from walking.gait_request import GaitRequest
from walking.gait_set import SPOT_TURNS, load_gaits, plan_spot_turn, save_gaits
from walking.robot import set_positions
from walking.schedules import candidate_schedules, format_schedule, parse_schedule
from walking.walk_trajectory import walk
from walking.walker import Walker
from walking.wayfinder import BEFORE, GAIT, GOAL, START, join_gaits

from .conftest import contacts_of_intervals, quickened

THREE = RobotParameters.in_space(3)


@pytest.fixture(scope="module")
def gaits() -> dict[str, Gait]:
    few = {"check": False, "intervals": 12, "temperature_margin": 5.0}
    ahead = plan_gait(THREE, **few)
    near = {"near": ahead, "schedule": ahead.schedule, "explain": False, **few}
    left = plan_gait(THREE, turn=0.2, begins_as=ahead, **near)
    spot = plan_gait(THREE, turn=-0.4, stride=0.0, schedule=ahead.schedule, **few)
    return {"ahead": ahead, "left": left, "spot": spot}


def calibrated(robot: RobotParameters) -> RobotParameters:
    robot = copy.deepcopy(robot)
    for limb in robot.limbs:
        limb.parameters.calibration = CalibrationRecord([], [], [], [])
    return robot


def test_potential_and_feet_match_drakes_plant():
    robot = RobotParameters.in_space(4)
    robot.limbs[1].e1, robot.limbs[1].e2 = [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]
    plant, walker = MultibodyPlant(1e-3), Walker(robot)
    robot.ground = None
    add_robot(plant, robot)
    plant.Finalize()
    context, rng, offset = plant.CreateDefaultContext(), np.random.default_rng(4), None
    for y in rng.normal(0.0, 0.3, (5, len(walker.stiffness))):
        set_positions(plant, context, robot, y[:6], y[6:])
        missed = walker.potential.values(y)[0] - plant.CalcPotentialEnergy(context)
        offset = missed if offset is None else offset
        assert missed == pytest.approx(offset, abs=1e-12)
        for limb, foot in zip(robot.limbs, walker.feet(y), strict=True):
            place = plant.GetFrameByName(f"{limb.name}_foot").CalcPoseInWorld(context)
            assert foot[2] == pytest.approx(place.translation()[2], abs=1e-12)
            # The travel is the centre's and what the foot rolls: the angle of the limb's end from
            # the vertical, towards where it leans.
            end = place.rotation().matrix()[:, 0]
            lean = np.arccos(-end[2]) * end[:2] / np.linalg.norm(end[:2])
            rolled = (foot[:2] - place.translation()[:2]) / robot.feet.radius
            if end[2] < -np.cos(np.pi / 4):  # up to 45°
                np.testing.assert_allclose(rolled, lean, atol=1.5e-3)


def test_a_gait_turns_with_its_contact_forces_and_feet(gaits):
    """The last knot is the first one, moved and turned; feet that stick do not move."""
    gait, walker = gaits["spot"], Walker(THREE)
    assert gait.turn == pytest.approx(-0.4)
    assert gait.stride == pytest.approx(0.0, abs=1e-9)
    y = np.vstack([gait.body_pose, gait.joint_angles])
    feet = walker.feet(y.T)[..., :2]
    turned = RollPitchYaw(0, 0, gait.turn).ToRotationMatrix().matrix()[:2, :2]
    np.testing.assert_allclose(feet[-1], feet[0] @ turned.T, atol=1e-7)
    forces = gait.contact_force.T.reshape(len(y.T), -1, 3)
    mu = THREE.ground.friction
    for k, contacts in enumerate(contacts_of_intervals(gait)):
        for foot, contact in enumerate(contacts):
            slip = feet[k + 1, foot] - feet[k, foot]
            if contact == "stick":
                assert np.linalg.norm(slip) < 1e-7
            elif np.linalg.norm(slip) > 1e-5:
                against = -mu * forces[k, foot, 2] * slip / np.linalg.norm(slip)
                np.testing.assert_allclose(forces[k, foot, :2], against, atol=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("ahead", marks=pytest.mark.whole),
        pytest.param("left", marks=pytest.mark.whole),
        "spot",
    ],
)
def test_three_limbs_walk_as_planned_with_contact(gaits, name):
    gait = gaits[name]
    assert gait.check.tolerance == STRIDE_TOLERANCE_IN_SPACE
    made = simulate_gait(gait, "", THREE, 1)
    assert not made.fall
    assert made.strides == pytest.approx([1.0], abs=0.05)
    assert max(made.aside) < 0.1


def test_a_gait_along_an_arc_begins_with_the_heat_of_the_one_ahead(gaits):
    first, then = (gaits[name].wire_temperature[:, 0] for name in ("ahead", "left"))
    np.testing.assert_allclose(then, first, atol=1e-9)


def test_a_gait_begins_as_warm_as_another_one_up_to_its_margin(gaits):
    ahead = gaits["ahead"]
    warmth = ahead.wire_temperature[:, 0]
    warmest = (warmth.min() + warmth.max()) / 2
    margin = THREE.as_single_limb.temperature_limits.maximum - warmest
    program = GaitProgram(
        THREE, ahead.schedule, ahead.intervals, temperature_margin=margin, begins_as=ahead
    )
    for each in (program, gait_planning._with_robot(program, THREE)):
        first = each.heat[0, : len(warmth)]
        for bounds in bounds_of_variables(each.prog):
            np.testing.assert_allclose(bounds[first], np.minimum(warmth, warmest))


def test_a_gait_of_gradual_paths_has_the_heat_of_the_true_ones(gaits, monkeypatch):
    """Its duty, without a solution of the program, which takes ten seconds."""
    monkeypatch.setattr("walking.gait_planning.START_CYCLES", 2)
    monkeypatch.setattr("walking.gait_planning._solve", lambda *_: gaits["spot"])
    robot = copy.deepcopy(THREE)
    for wire in robot.as_single_limb.wires:
        wire.law = HystereticLaw()
    program = GaitProgram(robot, gaits["spot"].schedule, gaits["spot"].intervals)
    gait = _solve_with_gradual_turns(program, None, 1.0)
    assert gait.robot == robot
    assert (gait.duty == gaits["spot"].duty).all()
    wires = LimbModel.of(robot.as_single_limb).wires
    times = np.array([0.0, gait.time[1]])
    duty = np.tile(gait.duty[:, 0], (2, 1))
    reached = wires.integrate_states(gait.wire_states[:, 0], duty, times)[-1]
    np.testing.assert_allclose(gait.wire_states[:, 1], reached, atol=1e-9)
    assert np.abs(gait.wire_temperature[:, -1] - gait.wire_temperature[:, 0]).max() < 4.0


@dataclasses.dataclass
class AlreadySmoothLaw(HystereticLaw):
    """A law of one's own, with memory, that is planned with as it is."""

    def smoothed(self):
        return self


@pytest.mark.parametrize("law", [HystereticLaw, AlreadySmoothLaw])
def test_gradual_paths_are_planned_with_where_a_law_has_them(monkeypatch, law):
    monkeypatch.setattr(gait_planning, "_solve_with_gradual_turns", lambda *_: "gradual")
    robot = copy.deepcopy(THREE)
    for wire in robot.as_single_limb.wires:
        wire.law = law()
    program = GaitProgram(robot, candidate_schedules(robot)[0], [2] * 6)
    if law is HystereticLaw:
        assert gait_planning._solve(program) == "gradual"
    else:
        with pytest.raises(PlanningError, match="IPOPT"):  # there is no time for it
            gait_planning._solve(program, max_time=1e-3)


def test_feet_of_calibrated_robots_carry_more_and_stand_apart(gaits):
    """A sixth of the weight, so that a robot that leans to a side does not tip over."""
    robot = calibrated(THREE)
    least = []
    for described in (THREE, robot):
        program = GaitProgram(described, gaits["ahead"].schedule, [2] * 6)
        loads = {int(index) for index in program.forces[..., -1].ravel()}
        for binding in program.prog.bounding_box_constraints():
            indices = program.prog.FindDecisionVariableIndices(binding.variables())
            if loads & {*indices}:
                least.append(binding.evaluator().lower_bound()[0] / program.load)
    num_loads = len(least) // 2
    assert least == pytest.approx([0.05] * num_loads + [0.16] * num_loads)
    assert num_loads == 12 * len(THREE.limbs)
    # The stiffness of the feet against roll and pitch is bounded, by the moments of places.
    stance = program.blocks[-1]
    assert (stance.lower == MIN_STANCE_STIFFNESS).all()
    x = np.zeros(program.prog.num_vars())
    x[program.y] = program.walker.rest
    places = program.walker.feet(program.walker.rest)[:, :2]
    least, largest = np.linalg.eigvalsh(np.cov(places.T, ddof=0) * 3 * robot.contact_stiffness)
    toppling = program.load * program.walker.size
    np.testing.assert_allclose(stance.evaluate(x), least * largest / (least + largest) / toppling)


def test_wires_go_from_heat_to_heat_along_a_line(gaits):
    """So that the limbs of a robot that stands go from one posture to the other."""
    before, gait = gaits["ahead"], gaits["spot"]
    walked = walk(gait, 1, heat=before.initial_heat, bend=before.bend_angle[:, 0])
    temperature = walked.wire_temperature[:, walked.time <= walked.duration - gait.period].T
    start, end = (each.wire_temperature[:, 0] for each in (before, gait))
    share = (temperature - start) @ (end - start) / ((end - start) @ (end - start))
    np.testing.assert_allclose(temperature, start + np.outer(share, end - start), atol=1.5)
    assert (np.diff(share) > 0.0).all()
    assert (temperature[-1] - end < 3.5).all()
    assert np.abs(temperature[-1] - end)[end > start].max() < 0.5


def test_cycles_one_after_the_other_are_moved_and_turned(gaits):
    twice = gaits["left"].repeated(2)
    one, two = gaits["left"].displacement, twice.displacement
    turned = RollPitchYaw(0, 0, one[2]).ToRotationMatrix().matrix()[:2, :2]
    np.testing.assert_allclose(two[:2], one[:2] + turned @ one[:2], atol=1e-12)
    assert two[2] == pytest.approx(2 * one[2])
    loads = twice.contact_force[2::3]
    np.testing.assert_allclose(loads[:, 0], loads[:, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("robot", "request_", "said"),
    [
        (RobotParameters(), {"turn": 0.1}, "vertical plane, in which it cannot turn"),
        (RobotParameters(), {"sticking_share": 1.2}, "sticking_share is 1.2"),
        (THREE, {"stride": 0.0}, "must turn"),
        (THREE, {"stride": 0.2}, "A stride of 200 mm cannot be had"),
        (THREE, {"turn": 1.5}, "which turns the body by"),
        (THREE, {"turn": math.inf, "speed": 1e-3}, "no speed"),
        (THREE, {"schedule": parse_schedule("fss sss sfs sss ssf sss", 3)}, "let them be dragged"),
        (
            THREE,
            {"speed": 0.1, "schedule": parse_schedule("dss sss sds sss ssd sss", 3)},
            "fastest",
        ),
    ],
)
def test_impossible_request_is_refused_in_a_sentence(robot, request_, said):
    with pytest.raises(PlanningError, match=said):
        plan_gait(robot, check=False, explain=False, intervals=12, **request_)


def test_a_robot_walks_to_a_place_with_contact(gaits, tmp_path, capsys):
    """By a folder of gaits and the command, from cold wires, which are eight times as quick."""
    folder, output, picture = (tmp_path / name for name in ("gaits", "walk.csv", "way.png"))
    gait = quickened(gaits["ahead"], 8.0)
    gait.check.simulation = GaitVariation("", [1.0])  # as if it was checked
    save_gaits({"ahead": gait, "spot_left": gait, "mine": gait}, folder)
    (folder / "notes.csv").write_text("mine")  # no gait
    with pytest.raises(OutputError, match=r"ahead\.csv exists; give another name, or --force"):
        save_gaits({"ahead": gait}, folder)
    save_gaits({"ahead": gait}, folder, force=True)
    assert sorted(path.name for path in folder.iterdir()) == ["ahead.csv", "notes.csv"]
    (folder / "notes.csv").unlink()
    assert [*load_gaits(folder)] == ["ahead"]
    words = ["walk", str(folder), "--model", "--to", "0.02,0", "-o", str(output)]
    assert main([*words, "--plot", str(picture)]) == 0
    assert "arrived     yes" in capsys.readouterr().out
    recording = Recording.load(output)
    assert np.hypot(*(recording.body_pose[:2, -1] - [0.02, 0.0])) < 0.015
    assert recording.interrupted == ""
    assert picture.stat().st_size > 10_000


def test_a_robot_turns_on_the_spot_on_feet_that_are_warped_by_a_millimetre():
    """By the gait of `plan_gaits`; with less friction to spare, such robots did not turn."""
    robot = calibrated(RobotParameters.in_space(4))
    request = GaitRequest(check=False, explain=False, intervals=12, temperature_margin=5.0)
    gait = plan_spot_turn(robot, 1.0, request)
    assert gait.turn == pytest.approx(SPOT_TURNS[0])
    warped = [robot for change, robot in variations(robot) if "warped" in change]
    assert len(warped) == 2
    for other in warped:
        simulated = simulate_gait(gait, "", other, 2)
        assert simulated.fall == ""
        assert simulated.strides[-1] >= 0.75


def test_calibrated_robots_turn_on_the_spot_with_rests_first():
    robot = calibrated(RobotParameters.in_space(4))
    request = GaitRequest(check=False, explain=False, intervals=12, temperature_margin=5.0)
    gait = plan_gait(robot, request, turn=-np.inf)
    assert gait.check.sticking_share == 0.5
    assert gait.turn < -SPOT_TURNS[0]
    assert format_schedule(gait.schedule) == "dssd ssss sdds ssss"


def test_no_turn_on_the_spot_is_taken_with_which_a_varied_robot_falls(gaits, monkeypatch):
    falling = copy.deepcopy(gaits["spot"])
    falling.check.spread = [GaitVariation("friction x 0.7", fall="its body tilts")]
    planned = iter([falling, gaits["spot"]])
    monkeypatch.setattr("walking.gait_set.plan_gait", lambda *_, **__: next(planned))
    assert plan_spot_turn(THREE, 1.0, GaitRequest()) is gaits["spot"]


def test_four_calibrated_limbs_have_more_friction_to_spare():
    """Three feet stand on any ground, and a plane's robots are in a line."""
    four = RobotParameters.in_space(4)
    # Ahead, along an arc, and on the spot, also as far as the robot can turn.
    courses = Course(), Course(0.2), Course(0.3, 0.0), Course(-np.inf)
    for robot, shares in (
        (calibrated(four), [0.6, 0.8, 0.5, 0.5]),
        (four, [0.8] * 4),
        (calibrated(THREE), [0.8] * 4),
        (calibrated(RobotParameters()), [0.8] * 4),
    ):
        assert [default_sticking_share(robot, course) for course in courses] == shares


@pytest.mark.parametrize(("num_limbs", "warps"), [(3, []), (4, [-1e-3, 1e-3])])
def test_four_feet_are_warped_either_way_in_the_spread(num_limbs, warps):
    robot = RobotParameters.in_space(num_limbs)
    heights = robot.hips[:, 2]
    found = []
    for change, other in variations(robot):
        raised = other.hips[:, 2] - heights
        if raised.any():
            assert change == f"feet warped by {1e3 * (raised @ [1, -1, -1, 1]):+g} mm"
            found.append(raised @ [1, -1, -1, 1])
    assert found == pytest.approx(warps)


def test_three_feet_in_a_plane_are_not_warped():
    """Though of three feet in a line, one may be higher."""
    robot = RobotParameters()
    middle = copy.deepcopy(robot.limbs[0])
    middle.name, middle.position = "middle", [0.0, 0.0, 0.0]
    robot.limbs.append(middle)
    assert warp_pattern(robot).any()
    assert not any("warped" in change for change, _ in variations(robot))


def test_gait_feedback_is_refused_in_space(gaits):
    with pytest.raises(LimbError, match="use heat feedback"):
        GaitFeedback(gaits["ahead"], 1)


@pytest.mark.parametrize(
    "goal", [[np.nan, 0.0], [np.inf, 0.0], [1e300, 0.0], [0.1], [0.1, 0.0, 0.0, 0.0], "0.1,0", None]
)
def test_goals_that_are_no_places_are_refused(gaits, goal):
    with pytest.raises(LimbError, match=r"goals\[1\] is .*; it must be x and y in m"):
        Wayfinder(gaits, [[0.1, 0.0, 0.0], goal])


def test_feet_in_space_are_dragged_along_each_side_and_in_pairs_across():
    """Feet in the order of their limbs: of four the rear and the front left, then the right."""
    three, four = (
        [format_schedule(schedule) for schedule in candidate_schedules(robot)]
        for robot in (THREE, RobotParameters.in_space(4))
    )
    assert three == ["sds sss dss sss ssd sss", "sds sss ssd sss dss sss"]
    assert four[0] == "dsss sdss ssds sssd"
    assert four[4] == "dssd ssss sdds ssss"


def test_each_part_of_a_joined_plan_leads_from_the_heat_of_one_gait_to_that_of_the_next(gaits):
    both = [gaits["ahead"], gaits["left"]]
    joined, starts, durations = join_gaits(both)
    cold = np.full(9, THREE.as_single_limb.ambient_temperature)
    for before, after in ((2, 0), (0, 0), (0, 1), (1, 0), (1, 1)):
        begin = starts[before, after]
        ends = np.array([begin, begin + durations[before, after]])
        first, last = joined.interpolated(joined.wire_temperature, ends).T
        heat_before = cold if before == 2 else both[before].wire_temperature[:, 0]
        np.testing.assert_allclose(first, heat_before, atol=1e-6)
        np.testing.assert_allclose(last, both[after].wire_temperature[:, 0], atol=0.5)


@pytest.mark.whole
def test_a_robot_gets_to_places_though_its_cycles_are_not_as_planned(gaits):
    """Kinematics alone: each cycle makes 0.7 of the way, and turns aside by 3°.

    The first cycle after another gait makes half as much, and goes aside by 8 mm.
    """
    goals = [(0.15, 0.0), (0.15, 0.1, math.pi / 2), (0.0, 0.0)]
    ahead = gaits["ahead"]
    few = {"schedule": ahead.schedule, "check": False, "intervals": 12, "temperature_margin": 5.0}
    right = plan_gait(THREE, turn=-0.2, near=ahead, explain=False, **few)
    gaits = {**gaits, "right": right}
    finder = Wayfinder(gaits, goals)
    course = finder.CreateDefaultContext().get_discrete_state(2).value().copy()
    pose, visited = np.zeros(3), []
    course[1], course[4:7] = 0, pose  # it does not begin from cold
    for _ in range(110):  # 94 are enough, as gaits with a margin of temperature are short
        x, y, turn = list(gaits.values())[int(course[2])].displacement * [0.7, 0.7, 0.8]
        if course[1] != course[2]:
            x, y, turn = 0.5 * x, y + 8e-3, 0.5 * turn
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        pose += np.array([cosine * x - sine * y, sine * x + cosine * y, turn + np.deg2rad(3.0)])
        before = int(course[3])
        finder._begin_cycle(course, pose, 0.0)
        visited += [pose.copy()] * (int(course[3]) - before)
        if course[3] == len(goals):
            break
    assert len(visited) == 3
    for place, (x, y, *heading) in zip(visited, goals, strict=True):
        assert np.hypot(place[0] - x, place[1] - y) <= 0.015
        if heading:
            assert np.cos(place[2] - heading[0]) >= np.cos(np.deg2rad(8.0))


@pytest.fixture(scope="module")
def planned_travels() -> dict[str, tuple[float, float, float]]:
    """Travel x, y, m, and yaw, rad, in a cycle of five gaits."""
    return {
        "ahead": (17.6e-3, 0.0, 0.0),
        "left": (20.7e-3, 2.1e-3, 0.19),
        "right": (21.8e-3, -2.2e-3, -0.19),
        "spot_left": (0.0, 0.0, 0.29),
        "spot_right": (0.0, 0.0, -0.27),
    }


def with_travel(gait: Gait, travel: tuple[float, float, float]) -> Gait:
    """Return a gait whose cycle makes another travel x, y, m, and yaw, rad."""
    body_pose = gait.body_pose.copy()
    body_pose[:, -1] = body_pose[:, 0]
    body_pose[[0, 1, 5], -1] += travel
    return dataclasses.replace(gait, body_pose=body_pose)


def walk_kinematically(
    finder: Wayfinder, travels: list[tuple[float, float, float]], max_cycles: int
) -> tuple[list[int], list[np.ndarray], np.ndarray]:
    """Walk by the true travel of each gait, until the robot arrives or no gait moves it.

    Returns:
        The gaits of the cycles, the poses at the places that were reached, and the last course.
    """
    course = finder.CreateDefaultContext().get_discrete_state(2).value().copy()
    pose = np.zeros(3)
    gaits = []
    visited = []
    for _ in range(max_cycles):
        gait = int(course[GAIT])
        place = pose[:2] + rotate_to_heading(np.array(travels[gait][:2]), -pose[2])
        pose = np.append(place, pose[2] + travels[gait][2])
        goal = int(course[GOAL])
        finder._begin_cycle(course, pose, 0.0)
        gaits.append(gait)
        if course[GOAL] > goal:
            visited.append(pose)
        if course[GOAL] == len(finder._goals) or not len(finder._useful_gaits(course)):
            break
    return gaits, visited, course


@pytest.mark.parametrize("spot_turns", [(1.0, 1.0), (0.0, 1.0), (0.0, 0.0), (-0.4, 0.0)])
def test_a_robot_that_does_not_turn_on_the_spot_goes_by_arcs(gaits, planned_travels, spot_turns):
    """To a place and a heading, and back, though turns on the spot make a share of the plan."""
    five = {name: with_travel(gaits["ahead"], travel) for name, travel in planned_travels.items()}
    finder = Wayfinder(five, [(0.5, 0.0, math.pi / 2), (0.0, 0.0)])
    travels = list(planned_travels.values())
    for gait, share in zip((3, 4), spot_turns, strict=True):
        travels[gait] = (0.0, 0.0, share * travels[gait][2])
    walked, visited, _ = walk_kinematically(finder, travels, 400)
    assert len(visited) == 2
    there, back = visited
    assert np.hypot(there[0] - 0.5, there[1]) <= 0.03
    assert np.cos(there[2] - math.pi / 2) >= np.cos(np.deg2rad(8.0))
    assert np.hypot(*back[:2]) <= 0.03
    if spot_turns == (1.0, 1.0):  # turns on the spot as planned are taken for granted
        there_by = "0212121000000212120011122331333"
        back_by = "3311111112200000212112121000"
        assert "".join(map(str, walked)) == there_by + back_by


def test_the_first_cycle_after_another_gait_tells_of_such_cycles_alone(gaits):
    finder = Wayfinder(gaits, [(0.5, 0.0)])
    course = finder.CreateDefaultContext().get_discrete_state(2).value().copy()
    for before, learned in ((0, [0]), (1, [0, 1, 2])):
        course[[BEFORE, GAIT]] = before, 1
        course[START : START + 3] = 0.0
        expected = finder._expected_travel(course).copy()
        finder._begin_cycle(course, np.zeros(3), 0.0)  # it made nothing
        changed = (finder._expected_travel(course) != expected).any(axis=2)
        assert np.argwhere(changed).tolist() == [[each, 1] for each in learned]


@pytest.mark.parametrize(
    ("pitch", "goal", "made", "reason"),
    [
        (0.0, 0.0, 1.0, ""),
        (1.1, 0.0, 1.0, "the robot has fallen"),
        (0.0, 1.0, 0.0, "the robot has arrived"),
        (0.0, 0.0, 0.1, "the robot does not get on"),
    ],
)
def test_a_walk_to_a_place_ends_with_a_reason(gaits, pitch, goal, made, reason):
    finder = Wayfinder(gaits, [(0.5, 0.0)])
    context = finder.CreateDefaultContext()
    finder.get_input_port(2).FixValue(context, [0.0, 0.0, 0.06, 0.0, pitch, 0.0])
    course = context.get_mutable_discrete_state(2).get_mutable_value()
    course[GOAL] = goal
    finder._expected_travel(course)[:] *= made
    status = finder._check_end(context)
    assert status.message() == reason
    assert (status.severity() == EventStatus.Severity.kReachedTermination) == bool(reason)


def test_a_place_has_a_tolerance_that_may_be_stretched(gaits):
    finder = Wayfinder(gaits, [(0.5, 0.0, math.pi)])
    heading = np.deg2rad(-180.0 + 9.0)
    poses = np.array([[0.5, 0.514, 0.517], [0.0] * 3, [math.pi, heading, math.pi]])
    assert finder.is_there(poses, 0).tolist() == [True, False, False]
    assert finder.is_there(poses, 0, slack=1.2).all()


def test_a_robot_that_no_gait_moves_is_stopped_after_each_was_tried(gaits, planned_travels):
    five = {name: with_travel(gaits["ahead"], travel) for name, travel in planned_travels.items()}
    finder = Wayfinder(five, [(0.15, 0.0)])
    slow = [tuple(0.1 * np.array(travel)) for travel in planned_travels.values()]
    walked, visited, course = walk_kinematically(finder, slow, 60)
    assert not visited
    assert {*walked} == set(range(5))
    assert not len(finder._useful_gaits(course))

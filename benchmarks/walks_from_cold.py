"""A crawler that walks from cold wires: open loop, with its bends held, and with `GaitFeedback`.

The gait is planned 5 °C below T_max, which is left to feedback. The robot is the one that it was
planned for; on a ground with 0.7 and 1.3 times the friction; with 0.67 times the friction under
one foot; and with k, β, a1 and a2 of each limb 10% larger or smaller, drawn at random. Feedback
knows the robot as planned. Shown are the strides of each cycle as shares of the planned one, the
last corrections of amplitude and duration, the highest temperature, and falls.

    python benchmarks/walks_from_cold.py [--draws 10] [--cycles 5] [--jobs 2] [--steadiness 25]
        [--sticking 0.8]
"""

import argparse
import multiprocessing
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: matrices are small

import numpy as np
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import TrajectorySource

from controllers import PlanFeedback, TemperatureSupervisor
from limb_systems.simulation import PERIOD, RecordOptions, record
from walking import Gait, GaitFeedback, Robot, RobotParameters, plan_gait, walk
from walking.gait_check import fall_of, with_friction, with_other_parameters
from walking.gait_program import STEADINESS, STICKING_SHARE
from walking.robot_twin import RobotSpecimen, _set_friction

MARGIN = 5.0  # °C
WAYS = ("open loop", "bends held", "GaitFeedback", "supervised")


def with_foot_friction(robot: RobotParameters, shares: list[float]) -> Robot:
    """A robot with its own share of the ground's friction under each foot."""
    system, specimen = Robot(robot), RobotSpecimen(robot, 0).without("body", "ground")
    specimen.foot_friction = (robot.ground.friction * np.array(shares)).tolist()
    plant, scene_graph = map(system.GetSubsystemByName, ("plant", "scene_graph"))
    _set_friction(scene_graph, plant, specimen)
    return system


def run(job: tuple[Gait, str, RobotParameters, list[float], str, int]) -> str:
    """A row of the table: what was varied, the way, and the figures."""
    gait, what, robot, shares, way, cycles = job
    walked, builder, system = (
        walk(gait, cycles),
        DiagramBuilder(),
        with_foot_friction(robot, shares),
    )
    corrects = way in WAYS[2:]
    if way == "open loop":
        controller = TrajectorySource(walked.duty_trajectory())
    else:
        controller = GaitFeedback(gait, cycles) if corrects else PlanFeedback(walked)
    builder.AddSystem(system)
    builder.AddSystem(controller)
    duty = controller.get_output_port(0)
    if way == "supervised":
        supervisor = builder.AddSystem(TemperatureSupervisor(gait.parameters))
        builder.Connect(duty, supervisor.GetInputPort("duty"))
        duty = supervisor.get_output_port()
        reading = supervisor.GetInputPort("measured_temperature")
        builder.Connect(system.GetOutputPort("measured_temperature"), reading)
    for index in range(controller.num_input_ports()):
        port = controller.get_input_port(index)
        builder.Connect(system.GetOutputPort(port.get_name()), port)
    course = [np.array([0.0, 0.0, 1.0, 1.0])]  # time, that in the walk, amplitude, duration

    def is_over(context) -> bool:
        now = np.array([context.get_time(), context.get_time(), 1.0, 1.0])
        if corrects:
            port = controller.GetOutputPort("correction")
            now[1:] = port.Eval(controller.GetMyContextFromRoot(context))[:3]
        course.append(now)
        return now[1] >= walked.duration

    spent = time.process_time()
    longest = walked.duration * (1.5 if corrects else 1.0)
    recording = record(builder, system, duty, longest, RecordOptions(until=is_over))
    spent = time.process_time() - spent
    times, in_walk, amplitude, slowness = np.array(course).T
    begin = PERIOD * np.floor((walked.duration - cycles * gait.period) / PERIOD + 0.5)
    ends = np.interp(begin + gait.period * np.arange(cycles + 1), in_walk, times)
    fall, until = fall_of(recording, gait, begin)
    x = np.interp(ends[ends <= until + 1.0], recording.time, recording.body_pose[0])
    strides = " ".join(f"{share:.3f}" for share in np.diff(x) / gait.stride)
    hottest = recording.wire_temperature.max()
    return (
        f"| {what} | {way} | {strides} | {amplitude[-1]:.2f}, {slowness[-1]:.2f} | {hottest:.1f} | "
        f"{fall or 'none'} | {recording.time[-1] / spent:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--cycles", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steadiness", type=float, default=STEADINESS)
    parser.add_argument("--sticking", type=float, default=STICKING_SHARE)
    options = parser.parse_args()
    gait = plan_gait(
        RobotParameters(),
        temperature_margin=MARGIN,
        steadiness=options.steadiness,
        sticking_share=options.sticking,
        check=False,
    )
    robots = [("as planned", gait.robot, [1.0, 1.0])]
    for factor in (0.7, 1.3):
        robots.append((f"friction x {factor}", with_friction(gait.robot, factor), [1.0, 1.0]))
    for limb, shares in zip(gait.robot.limbs, ([0.67, 1.0], [1.0, 0.67]), strict=True):
        robots.append((f"friction of the {limb.name} foot x 0.67", gait.robot, shares))
    rng = np.random.default_rng(options.seed)
    for draw in range(1, options.draws + 1):
        robots.append((f"draw {draw}", with_other_parameters(gait.robot, rng), [1.0, 1.0]))
    jobs = [(gait, *robot, way, options.cycles) for robot in robots for way in options.ways]
    print(gait)
    print("| robot | way | strides | amplitude, duration | T, °C | fall | x real time |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool:
        for row in pool.imap(run, jobs):
            print(row, flush=True)


if __name__ == "__main__":
    main()

"""Put a limb on ROS 2 topics: a robot, or an emulated limb in real time. docs/ros.md says more.

python examples/ros/bridge.py                                  # an emulated limb
python examples/ros/bridge.py -p /dev/ttyACM0 -l limb.yaml     # a robot
"""

import argparse
import re
import sys
from pathlib import Path

from ros_bridge.drive import drive
from ros_bridge.messages import Topics

from hardware import LimbTwin, SerialLimb
from hardware.replaying import check_replayable
from limb_systems import LimbError, LimbParameters, LimbSystem, Trajectory
from limb_systems.files.output import check_outputs
from soft_limb.command import run_words
from soft_limb.commands.options import Command, Option, shared


def _bridge(options: argparse.Namespace) -> int:
    # Check the files and the names of the topics.
    output = [options.output]
    inputs = [options.limb, options.plan]
    check_outputs(output, inputs=inputs, tables=output, force=options.force)
    for name in (options.duty, options.sensors, options.name):
        if not re.fullmatch(r"(/[A-Za-z]\w*)+", name, re.ASCII):
            raise LimbError(f"{name} is not the name of a topic; give a name such as /cmd_u_t.")
    # Load the plan, and make the limb.
    plan = Trajectory.load(options.plan) if options.plan else None
    parameters = LimbParameters.of(options.limb or (plan.parameters if plan else None))
    name = options.name
    topics = Topics(options.duty, f"{name}/run", options.sensors, f"{name}/plan", f"{name}/state")
    limb: LimbSystem
    if options.port:
        limb = SerialLimb(options.port, parameters)
    else:
        limb = LimbTwin.of(parameters, options.emulated)
    # Drive it until a signal comes.
    try:
        if plan:
            check_replayable(plan, limb)
        print(f"bridge      {limb.source} on {topics.duty}; Ctrl-C ends it", flush=True)
        drive(limb, plan=plan, topics=topics, output=options.output)
    finally:
        if isinstance(limb, SerialLimb):
            limb.close()
    return 0


COMMAND = Command(
    _bridge,
    "Connect a limb to ROS 2 topics until Ctrl-C: a robot, or without a port an emulated limb in "
    "real time. The bridge publishes the readings and the state of the limb at 20 Hz. It applies "
    "the duty from a topic, or starts and stops a plan. It does not apply a duty that is older "
    "than 250 ms, out of range, or from another writer. It needs no ROS 2 build.",
    "port emulated limb force",
    [
        Option("--plan", type=Path, help="trajectory that may be started (.csv)"),
        shared("output", required=False, help="recording to write (.csv)"),
        Option(
            "--duty",
            default=Topics.duty,
            metavar="TOPIC",
            help="topic of the duty, a Float64MultiArray (default %(default)s)",
        ),
        Option(
            "--sensors",
            default=Topics.sensors,
            metavar="TOPIC",
            help="topic of temperatures in °C and bend in rad, a Float64MultiArray (default "
            "%(default)s)",
        ),
        Option(
            "--name",
            default="/limb",
            help="first part of the topics NAME/state, NAME/plan and NAME/run (default "
            "%(default)s)",
        ),
    ],
    examples=["python examples/ros/bridge.py --emulated 3 --plan out/plan.csv"],
)

if __name__ == "__main__":
    sys.exit(run_words(COMMAND, "bridge.py", sys.argv[1:]))

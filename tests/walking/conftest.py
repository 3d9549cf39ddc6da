"""What tests of walking share."""

from walking import RobotParameters


def with_quick_wires(robot=None, factor=8.0) -> RobotParameters:
    """Return a robot whose wires heat and cool faster by a factor; cycles are as much shorter."""
    robot = robot or RobotParameters()
    for wire in robot.as_single_limb.wires:
        wire.law.a1 *= factor
        wire.law.a2 *= factor
        wire.law.a3 *= factor
    return robot

"""The robot, its emulated twin, and the replay of trajectories on them."""

from .emulation.emulator import emulated_port
from .emulation.robot_twin import RobotTwin
from .emulation.sensors import SensedLimb
from .emulation.twin import LimbTwin
from .replaying import ReplayError, present_readings, replay, watch
from .robot.link import BoardInfo, BoardLink, HardwareError, Sample
from .robot.serial_limb import SerialLimb
from .robot.text_board import AnswerLine, DutyLine, TextBoard
from .station import LimbDriver, Scenario, Station, StationError, drive

__all__ = [
    "AnswerLine",
    "BoardInfo",
    "BoardLink",
    "DutyLine",
    "HardwareError",
    "LimbDriver",
    "LimbTwin",
    "ReplayError",
    "RobotTwin",
    "Sample",
    "Scenario",
    "SensedLimb",
    "SerialLimb",
    "Station",
    "StationError",
    "TextBoard",
    "drive",
    "emulated_port",
    "present_readings",
    "replay",
    "watch",
]

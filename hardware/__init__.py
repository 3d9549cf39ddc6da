"""The robot, its emulated twin, and the replay of trajectories on them."""

import limb_systems  # noqa: F401 - before what takes long, see limb_systems.startup
from hardware.emulation.emulator import emulated_port
from hardware.emulation.robot_twin import RobotTwin
from hardware.emulation.sensors import SensedLimb
from hardware.emulation.twin import LimbTwin
from hardware.replay import ReplayError, present_readings, replay, watch
from hardware.robot.link import BoardInfo, BoardLink, HardwareError, Sample
from hardware.robot.serial_limb import SerialLimb
from hardware.station import LimbDriver, Scenario, Station, StationError, drive

__all__ = [
    "BoardInfo",
    "BoardLink",
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
    "drive",
    "emulated_port",
    "present_readings",
    "replay",
    "watch",
]

"""The robot, its emulated twin, and the replay of trajectories on them."""

from .board.link import BoardInfo, BoardLink, HardwareError, Sample
from .board.serial_limb import SerialLimb
from .emulation.emulator import emulated_port
from .emulation.twin import LimbTwin
from .replaying import ReplayError, present_readings, replay, watch
from .scenario import LimbDriver, Scenario, StationError
from .station import Station, drive

__all__ = [
    "BoardInfo",
    "BoardLink",
    "HardwareError",
    "LimbDriver",
    "LimbTwin",
    "ReplayError",
    "Sample",
    "Scenario",
    "SerialLimb",
    "Station",
    "StationError",
    "drive",
    "emulated_port",
    "present_readings",
    "replay",
    "watch",
]

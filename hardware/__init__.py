"""The robot, its emulated twin, and the replay of trajectories on them."""

from hardware.board.link import BoardInfo, BoardLink, HardwareError, Sample
from hardware.board.serial_limb import SerialLimb
from hardware.drivers import LimbDriver
from hardware.emulation.emulator import emulated_port
from hardware.emulation.sensors import SensedLimb
from hardware.emulation.twin import LimbTwin
from hardware.replay import ReplayError, present_readings, replay, watch
from hardware.scenario import Scenario, StationError
from hardware.station import Station, drive

__all__ = [
    "BoardInfo",
    "BoardLink",
    "HardwareError",
    "LimbDriver",
    "LimbTwin",
    "ReplayError",
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

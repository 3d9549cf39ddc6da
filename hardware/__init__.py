"""The robot, its emulated twin, and the replay of trajectories on them."""

from hardware.emulated_port import emulated_port
from hardware.link import BoardInfo, BoardLink, HardwareError, Sample
from hardware.replay import ReplayError, replay, watch
from hardware.sensors import SensedLimb
from hardware.serial_limb import SerialLimb
from hardware.twin import LimbTwin

__all__ = [
    "BoardInfo",
    "BoardLink",
    "HardwareError",
    "LimbTwin",
    "ReplayError",
    "Sample",
    "SensedLimb",
    "SerialLimb",
    "emulated_port",
    "replay",
    "watch",
]

"""The robot: its emulated twin, and the replay of trajectories on it."""

from hardware.replay import ReplayError, replay
from hardware.twin import LimbTwin

__all__ = ["LimbTwin", "ReplayError", "replay"]

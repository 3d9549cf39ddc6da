"""Robots of several limbs: what they are, how they stand and walk, and their commands."""

import importlib
from typing import Any

_HOMES = {
    "BodyParameters": "walking.robot_parameters",
    "FootParameters": "walking.robot_parameters",
    "Gait": "walking.gait",
    "GaitCheck": "walking.gait",
    "GaitFeedback": "walking.gait_feedback",
    "GaitPhase": "walking.gait",
    "GaitRequest": "walking.gait_request",
    "GaitVariation": "walking.gait",
    "GroundParameters": "walking.robot_parameters",
    "HeatFeedback": "walking.heat_feedback",
    "Robot": "walking.robot",
    "RobotLimb": "walking.robot_parameters",
    "RobotParameters": "walking.robot_parameters",
    "RobotTwin": "walking.robot_twin",
    "StridesFit": "walking.strides",
    "Wayfinder": "walking.wayfinder",
    "add_robot": "walking.robot",
    "check_gait": "walking.gait_check",
    "fit_strides": "walking.strides",
    "plan_gait": "walking.gait_planning",
    "plan_gaits": "walking.gait_set",
    "walk": "walking.walk_trajectory",
}

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """A public name, whose module is imported when it is asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)

"""Robots of several limbs: what they are, how they stand and walk, and their commands."""

from .gait import Gait, GaitCheck, GaitPhase, GaitVariation
from .gait_check import check_gait
from .gait_feedback import GaitFeedback
from .gait_planning import plan_gait
from .gait_request import GaitRequest
from .gait_set import plan_gaits
from .heat_feedback import HeatFeedback
from .robot import Robot, add_robot
from .robot_parameters import (
    BodyParameters,
    FootParameters,
    GroundParameters,
    RobotLimb,
    RobotParameters,
)
from .robot_twin import RobotTwin
from .strides import StridesFit, fit_strides
from .walk_trajectory import walk
from .wayfinder import Wayfinder

__all__ = [
    "BodyParameters",
    "FootParameters",
    "Gait",
    "GaitCheck",
    "GaitFeedback",
    "GaitPhase",
    "GaitRequest",
    "GaitVariation",
    "GroundParameters",
    "HeatFeedback",
    "Robot",
    "RobotLimb",
    "RobotParameters",
    "RobotTwin",
    "StridesFit",
    "Wayfinder",
    "add_robot",
    "check_gait",
    "fit_strides",
    "plan_gait",
    "plan_gaits",
    "walk",
]

"""A soft limb bent by shape-memory-alloy wires, as Drake systems."""

import importlib
from typing import Any

# ruff: noqa: E402 - what hides a package is said before it is imported
from limb_systems.shadows import check_shadows

check_shadows()

from limb_systems.band import Band, band
from limb_systems.bend_sensor import (
    BendSensor,
    ChordSensor,
    TipTangentSensor,
    bend_angle_from_tip_tangent,
)
from limb_systems.errors import LimbError
from limb_systems.files.provenance import Provenance
from limb_systems.files.recording import Recording
from limb_systems.files.trajectory import ActiveConstraint, PlanCheck, Trajectory
from limb_systems.heat_bounds import HeatBounds
from limb_systems.kinematics import (
    bend_angle,
    joint_angles_from_bend_angle,
    tip_position,
)
from limb_systems.layout import Layout
from limb_systems.limb import (
    Limb,
    LimbActuation,
    add_limb,
    add_limb_actuation,
    add_springs,
    from_paper_state,
    make_manipulator,
    split_state,
    to_paper_state,
)
from limb_systems.limb_parameters import (
    CalibrationRecord,
    EmulatedLimb,
    LimbParameters,
    NoBoard,
    RestMemory,
    SegmentParameters,
    SerialBoard,
    TemperatureLimits,
    WireParameters,
    wires_around,
)
from limb_systems.limb_system import LimbSystem
from limb_systems.simulation import simulate
from limb_systems.statics import resting_state
from limb_systems.views.limb_view import wire_color
from limb_systems.views.limb_visualizer import LimbVisualizer, WireColors
from limb_systems.views.replay_page import write_meshcat_replay
from limb_systems.wire_blocks import JouleHeating, ThermocoupleLag, TorqueMap
from limb_systems.wire_laws.coupled import CoupledLaw
from limb_systems.wire_laws.hysteretic import HystereticLaw
from limb_systems.wire_laws.linear import LinearLaw
from limb_systems.wire_laws.saturating import SaturatingLaw
from limb_systems.wire_laws.threshold import ThresholdLaw
from limb_systems.wire_laws.two_mass import TwoMassLaw
from limb_systems.wire_laws.wire_law import WireLaw
from limb_systems.wires import Wires

__all__ = [
    "ActiveConstraint",
    "Band",
    "BendSensor",
    "CalibrationRecord",
    "ChordSensor",
    "CoupledLaw",
    "EmulatedLimb",
    "HeatBounds",
    "HystereticLaw",
    "JouleHeating",
    "Layout",
    "Limb",
    "LimbActuation",
    "LimbError",
    "LimbParameters",
    "LimbSystem",
    "LimbVisualizer",
    "LinearLaw",
    "NoBoard",
    "PlanCheck",
    "Provenance",
    "Recording",
    "RestMemory",
    "SaturatingLaw",
    "SegmentParameters",
    "SerialBoard",
    "TemperatureLimits",
    "ThermocoupleLag",
    "ThresholdLaw",
    "TipTangentSensor",
    "TorqueMap",
    "Trajectory",
    "TwoMassLaw",
    "WireColors",
    "WireLaw",
    "WireParameters",
    "Wires",
    "add_limb",
    "add_limb_actuation",
    "add_springs",
    "band",
    "bend_angle",
    "bend_angle_from_tip_tangent",
    "from_paper_state",
    "joint_angles_from_bend_angle",
    "make_manipulator",
    "resting_state",
    "simulate",
    "split_state",
    "tip_position",
    "to_paper_state",
    "wire_color",
    "wires_around",
    "write_meshcat_replay",
]


def __getattr__(name: str) -> Any:
    """`Robot` and `RobotParameters`, which are in `walking`."""
    if name in ("Robot", "RobotParameters"):
        return getattr(importlib.import_module("walking"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

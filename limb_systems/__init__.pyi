"""A soft limb bent by shape-memory-alloy wires, as Drake systems."""

from .errors import LimbError
from .files.gait import Gait, GaitCheck, GaitPhase, GaitVariation
from .files.recording import Recording
from .files.trajectory import ActiveConstraint, PlanCheck, Trajectory
from .model.bend_sensor import (
    BendSensor,
    ChordSensor,
    TipTangentSensor,
    bend_angle_from_tip_tangent,
)
from .model.heat_bounds import HeatBounds
from .model.kinematics import (
    bend_angle,
    joint_angles_from_bend_angle,
    tip_position,
)
from .model.layout import Layout
from .model.limb import (
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
from .model.limb_system import LimbSystem
from .model.parameters import (
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
from .model.robot import Robot, add_robot
from .model.robot_parameters import (
    BodyParameters,
    FootParameters,
    GroundParameters,
    RobotLimb,
    RobotParameters,
)
from .model.statics import resting_state
from .model.two_mass_laws import (
    CoupledLaw,
    HystereticLaw,
    SaturatingLaw,
    ThresholdLaw,
    TwoMassLaw,
)
from .model.wire_blocks import JouleHeating, ThermocoupleLag, TorqueMap
from .model.wire_law import LinearLaw, WireLaw
from .model.wires import Wires
from .plan_band import Band, band
from .provenance import Provenance
from .simulation import simulate
from .views.limb_view import wire_color
from .views.limb_visualizer import LimbVisualizer, WireColors
from .views.replay_page import write_meshcat_replay

__all__ = [
    "ActiveConstraint",
    "Band",
    "BendSensor",
    "BodyParameters",
    "CalibrationRecord",
    "ChordSensor",
    "CoupledLaw",
    "EmulatedLimb",
    "FootParameters",
    "Gait",
    "GaitCheck",
    "GaitPhase",
    "GaitVariation",
    "GroundParameters",
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
    "Robot",
    "RobotLimb",
    "RobotParameters",
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
    "add_robot",
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

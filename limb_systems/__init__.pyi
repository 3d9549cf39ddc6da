"""A soft limb bent by shape-memory-alloy wires, as Drake systems."""

from .bend_sensor import (
    BendSensor,
    ChordSensor,
    TipTangentSensor,
    bend_angle_from_tip_tangent,
)
from .errors import LimbError
from .files.provenance import Provenance
from .files.recording import Recording
from .files.trajectory import ActiveConstraint, PlanCheck, Trajectory
from .heat_bounds import HeatBounds
from .kinematics import (
    bend_angle,
    joint_angles_from_bend_angle,
    tip_position,
)
from .limb import (
    Limb,
    LimbActuation,
    add_limb,
    add_limb_actuation,
    from_paper_state,
    make_manipulator,
    to_paper_state,
)
from .limb_model import LimbModel, split_state
from .limb_parameters import (
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
from .limb_system import LimbSystem
from .plan_band import Band, band
from .simulation import simulate
from .statics import resting_state
from .views.limb_view import WireColors, wire_color
from .views.replay_page import write_meshcat_replay
from .wire_blocks import JouleHeating, ThermocoupleLag, TorqueMap
from .wire_laws.coupled import CoupledLaw
from .wire_laws.hysteretic import HystereticLaw
from .wire_laws.linear import LinearLaw
from .wire_laws.saturating import SaturatingLaw
from .wire_laws.threshold import ThresholdLaw
from .wire_laws.two_mass import TwoMassLaw
from .wire_laws.wire_law import WireLaw

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
    "Limb",
    "LimbActuation",
    "LimbError",
    "LimbModel",
    "LimbParameters",
    "LimbSystem",
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
    "add_limb",
    "add_limb_actuation",
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

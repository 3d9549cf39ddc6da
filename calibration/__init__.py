"""Calibration of a limb from its recordings (Sec. V)."""

from calibration.calibrate import Calibration, calibrate
from calibration.collecting.bend_control import BendAngleController, EquilibriumSchedule
from calibration.collecting.collect import (
    collect_equilibria,
    collect_excitation,
    collect_first_contact,
    collect_ring_down,
    collect_sag,
    collect_warm_up,
)
from calibration.collecting.excitation import Excitation, LimitedDuty, excitations
from calibration.collecting.measurement_protocol import (
    Knowledge,
    collect_from_robot,
    collect_from_twin,
)
from calibration.estimate import Estimate
from calibration.heat_bounds_fit import fit_heat_bounds
from calibration.paper_method.mechanics import (
    DampedSinusoid,
    DampingFit,
    StiffnessFit,
    fit_damped_sinusoid,
    fit_damping,
    fit_stiffness,
)
from calibration.paper_method.wire_fits import ForceFit, HeatFit, fit_force, fit_heat_transfer
from calibration.prediction.expected_plan_error import PlanMiss
from calibration.prediction.law_fit import LawFit, Predicted, fit_law
from calibration.prediction.selection import Candidate, Prediction
from calibration.recordings.files import load_recordings, save_recordings
from calibration.recordings.kinds import kind_of, kinds_of
from calibration.recordings.recording_checks import check_recording
from calibration.remarks import CalibrationError
from calibration.validation import Validation, validate

__all__ = [
    "BendAngleController",
    "Calibration",
    "CalibrationError",
    "Candidate",
    "DampedSinusoid",
    "DampingFit",
    "EquilibriumSchedule",
    "Estimate",
    "Excitation",
    "ForceFit",
    "HeatFit",
    "Knowledge",
    "LawFit",
    "LimitedDuty",
    "PlanMiss",
    "Predicted",
    "Prediction",
    "StiffnessFit",
    "Validation",
    "calibrate",
    "check_recording",
    "collect_equilibria",
    "collect_excitation",
    "collect_first_contact",
    "collect_from_robot",
    "collect_from_twin",
    "collect_ring_down",
    "collect_sag",
    "collect_warm_up",
    "excitations",
    "fit_damped_sinusoid",
    "fit_damping",
    "fit_force",
    "fit_heat_bounds",
    "fit_heat_transfer",
    "fit_law",
    "fit_stiffness",
    "kind_of",
    "kinds_of",
    "load_recordings",
    "save_recordings",
    "validate",
]

"""Calibration of a limb from its recordings (Sec. V)."""

from calibration.calibrate import Calibration, calibrate, load_recordings
from calibration.checks import check_recording, kind_of
from calibration.collect import (
    collect_equilibria,
    collect_from_robot,
    collect_from_twin,
    collect_ring_down,
    collect_sag,
    collect_warm_up,
    save_recordings,
)
from calibration.controller import BendAngleController, EquilibriumSchedule
from calibration.damping import DampedSinusoid, DampingFit, fit_damped_sinusoid, fit_damping
from calibration.errors import CalibrationError
from calibration.estimate import Estimate
from calibration.figures import plot_validation
from calibration.force import ForceFit, fit_force
from calibration.heat import HeatFit, fit_heat_transfer, fit_heat_transfer_from_temperature
from calibration.heat_bounds import fit_heat_bounds
from calibration.kinds import kinds_of
from calibration.report import calibration_summary, write_report
from calibration.stiffness import StiffnessFit, fit_stiffness
from calibration.validation import Validation, validate

__all__ = [
    "BendAngleController",
    "Calibration",
    "CalibrationError",
    "DampedSinusoid",
    "DampingFit",
    "EquilibriumSchedule",
    "Estimate",
    "ForceFit",
    "HeatFit",
    "StiffnessFit",
    "Validation",
    "calibrate",
    "calibration_summary",
    "check_recording",
    "collect_equilibria",
    "collect_from_robot",
    "collect_from_twin",
    "collect_ring_down",
    "collect_sag",
    "collect_warm_up",
    "fit_damped_sinusoid",
    "fit_damping",
    "fit_force",
    "fit_heat_bounds",
    "fit_heat_transfer",
    "fit_heat_transfer_from_temperature",
    "fit_stiffness",
    "kind_of",
    "kinds_of",
    "load_recordings",
    "plot_validation",
    "save_recordings",
    "validate",
    "write_report",
]

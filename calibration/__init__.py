"""Calibration of a limb from its recordings (Sec. V)."""

import limb_systems  # noqa: F401 - before what takes long, see limb_systems.startup
from calibration.calibrate import Calibration, calibrate, load_recordings
from calibration.checks import check_recording, kind_of
from calibration.collect import (
    Knowledge,
    collect_equilibria,
    collect_excitation,
    collect_first_contact,
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
from calibration.excitation import Excitation, LimitedDuty, excitations
from calibration.force import ForceFit, fit_force
from calibration.heat import HeatFit, fit_heat_transfer, fit_heat_transfer_from_temperature
from calibration.heat_bounds import fit_heat_bounds
from calibration.kinds import kinds_of
from calibration.prediction import LawFit, Predicted, fit_law
from calibration.selection import Candidate, Prediction
from calibration.stiffness import StiffnessFit, fit_stiffness
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
    "fit_heat_transfer_from_temperature",
    "fit_law",
    "fit_stiffness",
    "kind_of",
    "kinds_of",
    "load_recordings",
    "save_recordings",
    "validate",
]

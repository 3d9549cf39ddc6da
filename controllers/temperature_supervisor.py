"""The temperature supervisor: it keeps wires from overheating, whatever a controller commands."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Diagram, LeafSystem, System

from controllers.estimator import Estimator, StateEstimate, pack
from controllers.reduced_model import ReducedModel
from limb_systems import LimbError, LimbParameters
from limb_systems.drake_python import weak_method
from limb_systems.limb_system import wrap_controller
from limb_systems.plan_band import temperature_margin
from limb_systems.simulation import PERIOD

HOLD_TIME = 0.5  # s, for which a duty must be harmless
DEVIATIONS = 2.0  # of the estimated temperature, by which predictions stay below the limit
# Errors of a thermocouple's lag, relative to its law; lags of 0.8 to 2.5 s are usual.
LAG_ERROR = 0.1
UNCALIBRATED_LAG_ERROR = 1.0
BOARD_MARGIN = 5.0  # °C, between feedback and the reading at which the board cuts out


def lag_error(parameters: LimbParameters) -> float:
    """Return the share of T - V by which wires may be warmer than estimated."""
    return LAG_ERROR if parameters.calibration else UNCALIBRATED_LAG_ERROR


class TemperatureLimiter:
    """The upper limit of a wire's duty.

    Under this duty the wire is predicted to be at its temperature limit in half a second, with
    margins for

    - two standard deviations of its estimate;
    - a thermocouple that lags more than its law (a tenth of T - V, or all of it if the limb is not
      calibrated);
    - the excess of a reading that the estimate does not believe yet.

    - ``limit``: ``temperature_limits.maximum`` less `temperature_margin`, but at least 5 °C below
      ``temperature_limits.measured_maximum``, °C.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        limits = parameters.temperature_limits
        highest = limits.maximum - temperature_margin(parameters)
        self.limit = min(highest, limits.measured_maximum - BOARD_MARGIN)
        self._lag_error = lag_error(parameters)
        self._model = ReducedModel(parameters, HOLD_TIME)

    def caps(self, estimate: StateEstimate, limit: ArrayLike | None = None) -> np.ndarray:
        """Return the most duty of each wire (W,), in [0, 1].

        Args:
            estimate: estimate of the limb.
            limit: lower limit of each wire (W,), °C, if any.
        """
        W = self._model.num_wires
        after, _, by_duty = self._model.linearized_step(estimate.heat, np.zeros(W))
        T = estimate.heat[:W]
        V = self._model.readings(estimate.heat)
        deviation = np.sqrt(np.diag(estimate.covariance)[:W])
        error = DEVIATIONS * deviation + self._lag_error * np.maximum(T - V, 0.0)
        highest = self.limit if limit is None else np.minimum(self.limit, limit)
        room = highest - error - estimate.reading_excess - after[:W]
        room = room - HOLD_TIME * estimate.heating_rate
        return np.clip(room / np.diag(by_duty[:W]), 0.0, 1.0)


class TemperatureSupervisor(LeafSystem):
    """A system after a controller that reduces duty before one of a limb's W wires overheats.

    The output is the duty nearest to the commanded duty with which each wire stays below the limit
    of `TemperatureLimiter`; duty that is no number is zero.

    - input 0 ``duty``: D (W), as commanded
    - input 1 ``measured_temperature``: V (W), °C; NaN where there is no reading
    - output 0 ``duty``: D (W), in [0, 1]
    - state, discrete, at 20 Hz: 0: the most duty (W); 1: the `StateEstimate`, NaN before the
      first readings
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: description of the limb.
        """
        super().__init__()
        parameters = LimbParameters.of(parameters)
        self._estimator = Estimator(parameters)
        self._limiter = TemperatureLimiter(parameters)
        # Ports, and the caps that follow from the readings.
        W = len(parameters.wires)
        duty = self.DeclareVectorInputPort("duty", W)
        self.DeclareVectorInputPort("measured_temperature", W)
        caps = self.DeclareDiscreteState(W)
        self.DeclareDiscreteState(self._estimator.nothing)
        self.DeclareVectorOutputPort(
            "duty",
            W,
            weak_method(self._calc_duty),
            {self.discrete_state_ticket(caps), self.input_port_ticket(duty.get_index())},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _update(self, context, state) -> None:
        readings = self.GetInputPort("measured_temperature").Eval(context)
        no_bend = np.full(self._estimator.model.num_bends, np.nan)
        estimate = self._estimator.read(state.value(1), readings, no_bend)
        estimate = self._estimator.predict(estimate, self._limited_duty(context, state.value(0)))
        state.set_value(0, self._limiter.caps(estimate))
        state.set_value(1, pack(estimate))

    def _calc_duty(self, context, output) -> None:
        output.SetFromVector(self._limited_duty(context, context.get_discrete_state(0).value()))

    def _limited_duty(self, context, caps: np.ndarray) -> np.ndarray:
        commanded = self.GetInputPort("duty").Eval(context)
        return np.clip(np.nan_to_num(commanded, nan=0.0), 0.0, caps)


def supervised(controller: System, parameters: LimbParameters) -> Diagram:
    """Return a controller behind a `TemperatureSupervisor`, with the controller's ports.

    Args:
        controller: with the output ``duty`` and any inputs that a limb has outputs for;
            it becomes part of the diagram.
        parameters: description of the limb.

    Returns:
        A system for ``replay(trajectory, limb, controller=...)``.

    Raises:
        LimbError: if the controller has no output ``duty`` for the limb's wires.
    """
    if not controller.HasOutputPort("duty"):
        raise LimbError(
            f"{type(controller).__name__} has no output port duty, and cannot be supervised."
        )
    num_duties = controller.GetOutputPort("duty").size()
    num_wires = len(parameters.wires)
    if num_duties != num_wires:
        raise LimbError(
            f"{type(controller).__name__} has a duty for {num_duties} wires, but the limb has "
            f"{num_wires}."
        )
    supervisor = TemperatureSupervisor(parameters)
    return wrap_controller(supervisor, controller)

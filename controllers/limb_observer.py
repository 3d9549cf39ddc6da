"""What the readings of a limb tell about what no sensor shows."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers.estimator import Estimate, Estimator
from controllers.reduced_model import PERIOD, ReducedModel
from limb_systems import LimbParameters
from limb_systems.model.ownership import weak_method

AHEAD = (0.25, 0.5, 0.75, 1.0)  # s, at which temperatures are predicted


class LimbObserver(LeafSystem):
    """An extended Kalman filter for a limb of W wires and S segments, with any wire law.

    Its outputs are what is expected at the next readings, from those so far.

    - input 0 ``duty``: D (W), in [0, 1], that the limb gets
    - input 1 ``measured_temperature``: V (W), °C; NaN where there is no reading
    - input 2 ``bend_angle``: φ (S), rad, as read; NaN where there is no reading
    - output 0 ``wire_temperature``: T (W), °C
    - output 1 ``temperature_deviation``: standard deviation of T (W), °C
    - output 2 ``heat``: [x, V] (H), the states of the wires' laws and the readings
    - output 3 ``bend_angle``: φ (S), rad, without the sensors' noise and drift
    - output 4 ``sensor_drift``: d (S), rad
    - output 5 ``torque_disturbance``: from outside, on each joint of the segments (S), N·m
    - output 6 ``believed``: of the thermocouples (W) and bend sensors (S), 1, or 0 for one
      whose last reading cannot be explained
    - output 7 ``highest_temperature``: the largest T within the next second (W), °C, if the
      duty stays
    - state, discrete, at 20 Hz: the `Estimate`, NaN before the first readings
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: of the limb.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        parameters = LimbParameters.of(parameters)
        self._estimator = Estimator(parameters)
        self._ahead = ReducedModel(parameters, AHEAD[0])
        model = self._estimator.model
        H, W, S = model.size, model.num_wires, model.num_segments
        self.DeclareVectorInputPort("duty", W)
        self.DeclareVectorInputPort("measured_temperature", W)
        self.DeclareVectorInputPort("bend_angle", S)
        state = self.DeclareDiscreteState(self._estimator.nothing)
        for name, size, calc in (
            ("wire_temperature", W, lambda e: e.heat[:W]),
            ("temperature_deviation", W, lambda e: np.sqrt(np.diag(e.covariance)[:W])),
            ("heat", H, lambda e: e.heat),
            ("bend_angle", S, lambda e: model.bend_angle(e.heat) + e.offset),
            ("sensor_drift", S, lambda e: e.drift),
            ("torque_disturbance", S, lambda e: e.offset / model.bend_by_torque),
            ("believed", W + S, lambda e: (e.unbelieved == 0).astype(float)),
        ):
            self.DeclareVectorOutputPort(
                name, size, self._shown(calc), {self.discrete_state_ticket(state)}
            )
        self.DeclareVectorOutputPort(
            "highest_temperature", W, weak_method(self._calc_highest_temperature)
        )
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))
        self.set_name("limb_observer")

    def _shown(self, calc):
        estimate = weak_method(self._estimate)
        return lambda context, output: output.SetFromVector(calc(estimate(context)))

    def _estimate(self, context) -> Estimate:
        vector = context.get_discrete_state(0).value()
        if np.isnan(vector).any():
            readings, bend = (self.get_input_port(index).Eval(context) for index in (1, 2))
            return self._estimator.begin(readings, bend)
        return self._estimator.unpack(vector)

    def _update(self, context, state) -> None:
        duty, readings, bend = (self.get_input_port(index).Eval(context) for index in range(3))
        estimate = self._estimator.read(state.value(0), readings, bend)
        state.set_value(self._estimator.pack(self._estimator.predicted(estimate, duty)))

    def _calc_highest_temperature(self, context, output) -> None:
        estimate, duty = self._estimate(context), self.get_input_port(0).Eval(context)
        W, heats = self._ahead.num_wires, [estimate.heat]
        for _ in AHEAD:
            heats.append(self._ahead.step(heats[-1], duty))
            heats[-1][:W] += AHEAD[0] * estimate.heating_rate
        output.SetFromVector(np.max(heats, axis=0)[:W])

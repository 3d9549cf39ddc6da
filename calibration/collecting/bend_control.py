"""Hold a limb at bend angles: the PI controller and the schedule of Sec. V-C."""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from calibration.recordings.kinds import heated_wires, only_segment
from limb_systems import LimbModel, LimbParameters
from limb_systems.drake_python import declare_state_output, weak_method
from limb_systems.simulation import PERIOD

DUTY_TAPER = 15.0  # °C below the cut-out, over which the largest duty falls to zero
CUT_OUT_MARGIN = 5.0  # °C below T_max, where a wire is switched off
CUT_OUT_HYSTERESIS = 5.0  # °C, by which it then cools before it is switched on again
MAX_DUTY = 0.5
CO_CONTRACTION_DUTY = 0.08


class BendAngleController(LeafSystem):
    """PI control of the bend angle of one segment, by one of its W wires or by all.

        u = k_p e + k_i ∫ e dt,   e = φ_eq - φ
        D = D_c + u  of a wire that bends towards +E2,  D_c - u  of any other

    limited to [0, D_max]; a wire that is not actuated stays off. D_c is zero if only one
    is. Over the last 15 °C before the cut-out, 5 °C below T_max, the limit falls to zero,
    and a wire whose measured temperature reaches it stays off until it has cooled by 5 °C.
    The integral stands still while u is beyond what the wires may do (anti-windup).

    The gains follow from the limb's description: the loop's gain is 1.5, and
    the controller's zero cancels the pole of (6), with which a wire cools.

    - input 0 ``bend_angle``: φ (1), rad
    - input 1 ``measured_temperature``: V (W), °C
    - input 2 ``set_point``: φ_eq (1), rad
    - output 0 ``duty``: D (W), in [0, D_max]
    - state, discrete, at 20 Hz: [∫ e dt (1), is cut out (W), D (W)], rad s, 0 or 1, 1
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, actuated: str):
        """
        Args:
            parameters: the limb, as far as it is known, of one segment.
            actuated: name of the wire, or "both" for all of them.

        Raises:
            LimbError: if the limb has several segments, or no such wire.
        """
        super().__init__()
        segment = only_segment(parameters)
        heated_indices = heated_wires(parameters, actuated)
        wires = LimbModel.of(parameters).wires
        # Bend angle per duty in the end, by (6), (12), in rad, of the last wire about T_max / 2.
        middle = 0.5 * (parameters.temperature_limits.maximum + parameters.ambient_temperature)
        torques = []
        duties = []
        for last in (middle - 1.0, middle + 1.0):
            temperature = np.append(np.full(wires.num_wires - 1, middle), last)
            states = wires.settled_states(temperature)
            torques.append(wires.forces(states, np.zeros(len(wires.levers)))[0])
            duties.append(wires.holding_duty(states)[-1])
        steady = (torques[1] - torques[0]) / (duties[1] - duties[0])
        gain = segment.chain.bend_by_equal_angle * abs(steady) / segment.stiffness
        # Choose gains for a loop gain of 1.5 and a zero at the slowest pole.
        slowest = np.abs(np.diag(wires.affine_rates()[0])[: wires.num_wires]).min()
        self._proportional_gain = 1.5 / gain
        self._integral_gain = 1.5 / gain * slowest
        # 1 or -1 of a wire that bends towards or away from +E2; 0 of a wire that is not actuated.
        self._bend_signs = [0.0] * wires.num_wires
        for index in heated_indices:
            self._bend_signs[index] = float(np.sign(segment.wires[index].lever[0]))
        self._co_contraction = CO_CONTRACTION_DUTY if len(heated_indices) > 1 else 0.0
        self._cut_out_temperature = parameters.temperature_limits.maximum - CUT_OUT_MARGIN
        # Declare ports and state.
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareVectorInputPort("measured_temperature", wires.num_wires)
        self.DeclareVectorInputPort("set_point", 1)
        state = self.DeclareDiscreteState(1 + 2 * wires.num_wires)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._update))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, weak_method(self._update))
        duty = slice(1 + wires.num_wires, 1 + 2 * wires.num_wires)
        declare_state_output(self, "duty", state, duty)

    def _update(self, context, discrete_state):
        # Calculate with numbers, because arrays of one or two take several times as long.
        state = context.get_discrete_state_vector().value().tolist()
        integral = state[0]
        were_cut_out = state[1 : 1 + len(self._bend_signs)]
        measured_temperature = self.EvalVectorInput(context, 1).value().tolist()
        error = self.EvalVectorInput(context, 2)[0] - self.EvalVectorInput(context, 0)[0]
        error_sign = math.copysign(1.0, error)
        # Limit the duty by the temperature.
        is_cut_out = []
        limits = []
        available_duty = 0.0  # of wires that reduce the error
        for index, bend_sign in enumerate(self._bend_signs):
            room = self._cut_out_temperature - measured_temperature[index]  # °C
            is_off = room <= CUT_OUT_HYSTERESIS * were_cut_out[index]
            is_cut_out.append(float(is_off))
            # There is no duty without a reading.
            has_duty = bend_sign and room > 0.0 and not is_off
            limits.append(MAX_DUTY * min(room / DUTY_TAPER, 1.0) if has_duty else 0.0)
            if bend_sign == error_sign:
                available_duty = max(available_duty, limits[index])
        # Compute the PI command, and integrate unless it is at its limit.
        command = self._proportional_gain * error + self._integral_gain * integral
        if not error_sign * command > available_duty:
            integral += PERIOD * error
        duty = []
        for bend_sign, limit in zip(self._bend_signs, limits, strict=True):
            wanted_duty = self._co_contraction + bend_sign * command
            duty.append(min(max(wanted_duty, 0.0), limit))
        discrete_state.set_value([integral, *is_cut_out, *duty])


class EquilibriumSchedule(LeafSystem):
    """Bend angles one after the other, each held until the limb has settled.

    The limb has settled when the measured temperature moves by less than
    0.1 °C/s and the bend angle is within 3° of the set point, both averaged
    over some seconds, for 5 s. Nothing is held longer than the limit.

    - input 0 ``bend_angle``: φ (1), rad
    - input 1 ``measured_temperature``: V (W), °C
    - output 0 ``set_point``: φ_eq (1), rad
    - state, discrete, at 20 Hz: [index of the angle, time in it, time settled,
      averaged φ, averaged V (W)], 1, s, s, rad and °C
    """

    __slots__ = ()  # see limb_systems.drake_python

    AVERAGING_TIME = 4.0  # s
    SLOW = 0.1  # °C/s
    NEAR_ANGLE = np.deg2rad(3.0)
    SETTLED_TIME = 5.0  # s

    def __init__(self, angles: Sequence[float], longest: float = 60.0, *, num_wires: int = 2):
        """
        Args:
            angles: φ_eq one after the other, rad.
            longest: time limit for each of them, s.
            num_wires: W.
        """
        super().__init__()
        self._angles = [*map(float, angles)]
        self._longest = longest
        self.DeclareVectorInputPort("bend_angle", 1)
        self.DeclareVectorInputPort("measured_temperature", num_wires)
        state = self.DeclareDiscreteState(4 + num_wires)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._start))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, PERIOD, weak_method(self._update))
        self.DeclareVectorOutputPort(
            "set_point", 1, weak_method(self._calc), {self.discrete_state_ticket(state)}
        )

    def is_finished(self, context: Context) -> bool:
        """Return whether the last angle was held, in the system's own context."""
        return context.get_discrete_state_vector()[0] >= len(self._angles)

    def _start(self, context, discrete_state):
        discrete_state.set_value([0.0, 0.0, 0.0, *self._present(context)])

    def _present(self, context: Context) -> list[float]:
        """Return the inputs [φ, V (W)], rad and °C."""
        measured = self.EvalVectorInput(context, 1).value().tolist()
        return [self.EvalVectorInput(context, 0)[0], *measured]

    def _update(self, context, discrete_state):
        state = context.get_discrete_state_vector().value().tolist()
        index, time_held, time_settled, *averages = state
        # Average the inputs, and see whether the limb has settled.
        is_quiet = True
        for element, reading in enumerate(self._present(context)):
            average = averages[element]
            if math.isnan(average):  # a board may miss a reading
                average = reading
            present = average if math.isnan(reading) else reading
            average += PERIOD / self.AVERAGING_TIME * (present - average)
            averages[element] = average
            if element == 0:
                is_quiet = abs(average - self._angle(index)) < self.NEAR_ANGLE
                continue
            slope = (present - average) / self.AVERAGING_TIME  # of a ramp, in the end
            is_quiet = is_quiet and abs(slope) < self.SLOW  # nan: not known yet
        time_held = time_held + PERIOD
        time_settled = time_settled + PERIOD if is_quiet else 0.0
        # Go on to the next angle when settled or late.
        if time_settled >= self.SETTLED_TIME or time_held >= self._longest:
            index = index + 1
            time_held = 0.0
            time_settled = 0.0
        discrete_state.set_value([index, time_held, time_settled, *averages])

    def _angle(self, index: float) -> float:
        return self._angles[min(int(index), len(self._angles) - 1)]

    def _calc(self, context, output):
        output.SetFromVector([self._angle(context.get_discrete_state_vector()[0])])

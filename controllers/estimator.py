"""The state estimate of a limb: an extended Kalman filter on `ReducedModel`.

It estimates the heat [x, V] (H) of W wires, and errors of the model and of the sensors of F bends:

- a heating rate q (W), by which the wires warm faster than their law says (another supply
  voltage, a fan, a warmer room);
- the drift d (F) of the bend sensors;
- a bend p (F) that lasts, of a torque from outside, such as a payload's, or of an unknown rest
  angle;
- the residual r (F) of the model's bend, which comes and goes as the wires' heat changes:

    readings  V + v,   bend  φ(x) + p + r + d + w
    Ṫ = law + q,   q̇ = -q / τ_q + noise,   ḋ = -d / τ_d + noise,   ṗ = noise
    ṙ = -r / τ_r + noise · √(bend that the wires' heat makes, to and fro)
"""

import dataclasses
import math
from typing import Any, TypeVar

import numpy as np
from pydrake.systems.framework import LeafSystem

from controllers.reduced_model import ReducedModel
from limb_systems import LimbModel, LimbParameters, Recording
from limb_systems.drake_python import weak_method
from limb_systems.simulation import PERIOD

PREDICTION_TIMES = (0.25, 0.5, 0.75, 1.0)  # s, at which the observer predicts temperatures

GATE_DEVIATIONS = 5.0  # standard deviations, beyond which a reading is not believed
MAX_OFFSET = np.deg2rad(20.0)  # rad, of p and d; a bend further from the model is not believed
# s, after which an unchanged reading is not believed, of bend sensors and of thermocouples, whose
# steps are coarse. A wire at rest may be read so: then nothing is lost.
STUCK_TIME = 0.5
STUCK_READING_TIME = 2.0
STUCK_CHANGE = 5.0  # °C, by which a wire warms or cools while its reading is unchanged
MAX_JUMP = 10.0  # °C, the largest change of a wire from one reading of the board to the next
WAITING_TIME = 3.0  # s, after which a reading that is too hot since a jump is believed
RAISED_TIME = 30.0  # s, in which such a jump is forgotten
# s, after which p and d are forgotten if the bend reads otherwise, because their cause has gone:
# a load, or a fault of the sensor. They are kept while the reading jumps by more than so much, rad.
FORGET_TIME = 0.5
FORGET_MAX_JUMP = np.deg2rad(5.0)

# The noise of thermocouples with steps of 0.25 °C that are read at 10 Hz and used at 20 Hz.
READING_NOISE = 0.4  # °C
# Errors of the laws, as random walks: standard deviations after one second.
TEMPERATURE_WALK = 0.5  # °C, of states that are temperatures
READING_WALK = 0.1  # °C
OTHER_WALK = 0.005  # of the typical change of other states
HEATING_ERROR = 0.1  # of the heating by duty, in addition
BEND_WALK = np.deg2rad(0.1)  # rad, of p
# r changes by the calibration's mean error of bends while the wires bend the limb by
# RESIDUAL_PATH, rad, in all, to and fro. With these values the bends of calibrated limbs of three
# emulated physics are estimated best, now and seconds ahead.
UNKNOWN_BEND_ERROR = np.deg2rad(1.0)  # rad, the mean error of a limb that is not calibrated
RESIDUAL_PATH = np.deg2rad(20.0)
RESIDUAL_TIME = 20.0  # s, in which r is forgotten
HEATING_RATE = 1.0  # °C/s, of q
HEATING_TIME = 15.0  # s, in which the correlation of q falls to 1/e
DRIFT_TIME = 120.0  # s, in which the correlation of d falls to 1/e
# rad, of p where the rest angle has no standard error, or where the first bend is off by more than
# so many standard deviations.
INITIAL_BEND = np.deg2rad(3.0)
UNLOADED_DEVIATIONS = 2.0
INITIAL_TEMPERATURE = 1.0  # °C
EXPLAINED_DEVIATIONS = 2.0  # standard deviations; a bend that is read farther off is unexplained
SILICONE_ERROR = 5.0  # °C, of the silicone around a warm wire, and of the other states in it

BEND_FIELDS = ("drift", "lasting", "residual")  # the estimates of each bend in a `StateEstimate`

Record = TypeVar("Record")


@dataclasses.dataclass(frozen=True, eq=False)
class StateEstimate:
    """The estimate of a limb's state at a time.

    - ``heat``: [x, V] (H).
    - ``heating_rate``: q (W), °C/s.
    - ``drift``: d (F), rad.
    - ``lasting``: p (F), rad.
    - ``residual``: r (F), rad.
    - ``covariance``: covariance of the five above, in this order (M, M).
    - ``unbelieved_time``: time since each thermocouple and bend was last believed (W + F), s.
    - ``unchanged_time``: time since each reading last changed (W + F), s.
    - ``unread_change``: change of each wire's temperature since its reading changed (W), °C.
    - ``recent_rise``: recent rise of the estimate to readings that were too hot (W), °C.
    - ``reading_excess``: excess of readings that are too hot and not believed yet (W), °C.
    - ``last_readings``: last readings (W + F), °C and rad.
    """

    heat: np.ndarray
    heating_rate: np.ndarray
    drift: np.ndarray
    lasting: np.ndarray
    residual: np.ndarray
    covariance: np.ndarray
    unbelieved_time: np.ndarray
    unchanged_time: np.ndarray
    unread_change: np.ndarray
    recent_rise: np.ndarray
    reading_excess: np.ndarray
    last_readings: np.ndarray

    @property
    def offset(self) -> np.ndarray:
        """The bend of the limb less the bend of the model, p + r (F,), rad."""
        return self.lasting + self.residual


def pack(record: Any) -> np.ndarray:
    """Return a dataclass of arrays and numbers as one vector, for a system's discrete state."""
    return np.concatenate([np.ravel(value) for value in vars(record).values()])


def unpack(vector: np.ndarray, like: Record) -> Record:
    """Return the dataclass in a vector of `pack`, whose fields have the shapes of ``like``."""
    shapes = [np.shape(value) for value in vars(like).values()]
    parts = np.split(vector, np.cumsum([math.prod(shape) for shape in shapes])[:-1])
    return type(like)(*map(np.reshape, parts, shapes))


class Estimator:
    """The filter's steps; its state is a `StateEstimate`, or the same numbers in one vector.

    - ``model``: the limb's `ReducedModel`.
    - ``nothing``: vector of a limb that was not read yet, all NaN.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters | LimbModel):
        limb = LimbModel.of(parameters)
        self.parameters = parameters = limb.parameters
        model = self.model = ReducedModel(limb)
        H = model.size
        W = model.num_wires
        F = model.num_bends
        period = model.period
        layout = limb.layout
        record = parameters.calibration
        self._bends_of = layout.bends_of

        def of_all(heat, rate, drift, bend, residual):
            """Return the vector (M,) of all that is estimated, in the order of `_split`."""
            return np.concatenate(
                [heat, np.full(W, rate), drift, np.full(F, bend), np.full(F, residual)]
            )

        # Noise of the readings.
        sensors = [parameters.segments[s].bend_sensor for s in layout.bend_segment]
        noise = np.maximum([sensor.noise for sensor in sensors], np.deg2rad(0.1))
        drift = np.array([sensor.drift for sensor in sensors])
        self._reading_variances = np.concatenate([np.full(W, READING_NOISE), noise]) ** 2

        # Random walks of the states, and the decay of means.
        temperatures = model.scales >= 10.0
        walks = np.where(temperatures, TEMPERATURE_WALK, OTHER_WALK * model.scales)
        walks[-W:] = READING_WALK
        rate_walk = 2 * HEATING_RATE**2 / HEATING_TIME
        drift_walk = 2 * drift**2 / DRIFT_TIME
        self._walk = period * of_all(walks**2, rate_walk, drift_walk, BEND_WALK**2, 0.0)
        self._decay = of_all(
            np.zeros(H),
            np.exp(-period / HEATING_TIME),
            np.full(F, np.exp(-period / DRIFT_TIME)),
            1.0,
            np.exp(-period / RESIDUAL_TIME),
        )
        error = (record and record.bend_error) or UNKNOWN_BEND_ERROR
        self._residual_rate = error**2 / RESIDUAL_PATH  # rad² per rad of bend, to and fro
        self._heating = period * model.heating_rates  # °C per step, by full duty

        # Standard deviations at the start.
        initial = np.where(temperatures, SILICONE_ERROR, 0.0)
        initial[:W] = INITIAL_TEMPERATURE
        initial[-W:] = INITIAL_TEMPERATURE
        self._initial = of_all(initial, HEATING_RATE / 2, drift, INITIAL_BEND, 0.0)
        self._others = np.flatnonzero(~temperatures)
        # Of the rest angle of a limb without a load: the calibration's standard error.
        self._rest_error = np.full(F, INITIAL_BEND)
        for direction, name in enumerate(["rest_angle", "rest_angle_e3"]):
            if record is not None and name in record.names:
                error = record.standard_errors[record.names.index(name)]
                self._rest_error[layout.bend_direction == direction] = error

        self._template = self.begin(np.full(W, np.nan), np.full(F, np.nan))
        self.nothing = np.full_like(pack(self._template), np.nan)

    def begin(
        self,
        readings: np.ndarray,
        bend_angle: np.ndarray,
        known_offset: np.ndarray | float = 0.0,
    ) -> StateEstimate:
        """Return the estimate for a limb at rest, whose silicone is as warm as its wires.

        A small error of the first bend is attributed to the sensor's drift and the rest angle's
        error, as no reading tells these from a payload. A larger error is attributed to a payload.

        Args:
            readings: V (W), °C; NaN where there is none.
            bend_angle: readings of the bend sensors (F), rad; NaN where there is none.
            known_offset: bends from outside that are known (F,), rad, and do not count.
        """
        W = self.model.num_wires
        F = self.model.num_bends
        # The heat of a limb with these readings, and its standard deviations.
        temperature = np.where(np.isfinite(readings), readings, self.model.cold[-W:])
        heat = self.model.rested(temperature)
        deviations = self._initial.copy()
        warmer = self.model.rested(temperature + SILICONE_ERROR) - heat
        deviations[self._others] = warmer[self._others]
        # How far the limb may rest from the model; farther where a payload bends it.
        lasting = deviations[-2 * F : -F]  # of p, a view
        lasting[:] = self._rest_error
        bend, C = self._measurement_model(heat)
        variances = ((C[W:] * deviations) ** 2).sum(axis=1) + self._reading_variances[W:]
        off = np.abs(self._without_sensor_errors(bend_angle) - known_offset - bend)
        lasting[off > UNLOADED_DEVIATIONS * np.sqrt(variances)] = INITIAL_BEND
        return StateEstimate(
            heat,
            np.zeros(W),
            np.zeros(F),
            np.zeros(F),
            np.zeros(F),
            np.diag(deviations**2),
            unbelieved_time=np.zeros(W + F),
            unchanged_time=np.zeros(W + F),
            unread_change=np.zeros(W),
            recent_rise=np.maximum(temperature - self.model.cold[-W:], 0.0),
            reading_excess=np.zeros(W),
            last_readings=np.concatenate([temperature, np.nan_to_num(bend_angle)]),
        )

    def read(
        self,
        vector: np.ndarray,
        readings: np.ndarray,
        bend_angle: np.ndarray,
        known_offset: np.ndarray | float = 0.0,
    ) -> StateEstimate:
        """Return a packed estimate after `correct`, with its arguments, or `begin` if it is NaN."""
        if np.isnan(vector).any():
            return self.begin(readings, bend_angle, known_offset)
        return self.correct(self.unpack(vector), readings, bend_angle, known_offset)

    def unpack(self, vector: np.ndarray) -> StateEstimate:
        """Return the estimate in a vector of `pack`."""
        return unpack(vector, self._template)

    def correct(
        self,
        estimate: StateEstimate,
        readings: np.ndarray,
        bend_angle: np.ndarray,
        known_offset: np.ndarray | float = 0.0,
    ) -> StateEstimate:
        """Return the estimate after readings, as far as they are believed.

        A thermocouple that reads hotter than expected is believed beyond the gate, too, because a
        wrong estimate must not overheat a wire: its wire is taken to be so much hotter. After a
        jump, the reading has to stay for a while first. It is believed when it jumps back.

        Args:
            estimate: the estimate before these readings.
            readings, bend_angle, known_offset: as for `begin`.
        """
        model = self.model
        W = model.num_wires
        F = model.num_bends
        period = model.period

        # Find the sensors that work: those whose readings are numbers and are not stuck.
        read = np.concatenate([readings, bend_angle])
        is_same = read == estimate.last_readings
        unchanged_time = np.where(is_same, estimate.unchanged_time + period, 0.0)
        unread_change = np.where(is_same[:W], estimate.unread_change, 0.0)
        is_frozen = np.abs(unread_change) > STUCK_CHANGE
        stuck_times = np.repeat([STUCK_READING_TIME, STUCK_TIME], [W, F])
        works = np.isfinite(read) & (unchanged_time < stuck_times)
        works[:W] &= ~is_frozen

        # Believe the readings that are within the gate of the prediction.
        model_bend, C = self._measurement_model(estimate.heat)
        bend = self._without_sensor_errors(bend_angle) - known_offset
        expected_bend = model_bend + estimate.offset + estimate.drift
        innovations = np.concatenate(
            [readings - model.readings(estimate.heat), bend - expected_bend]
        )
        spread = C @ estimate.covariance @ C.T + np.diag(self._reading_variances)
        gate = GATE_DEVIATIONS * np.sqrt(np.diag(spread))
        believed = works & (np.abs(innovations) < gate)
        believed[W:] &= np.abs(bend - model_bend) < MAX_OFFSET
        unbelieved_time = np.where(believed, 0.0, estimate.unbelieved_time + period)

        # Move wires to readings that are too hot, and back from them.
        warmer = innovations[:W]
        rise = readings - estimate.last_readings[:W]
        is_hot = works[:W] & (warmer >= gate[:W])
        waits = (rise > MAX_JUMP) | (estimate.reading_excess > 0.0)
        waits &= is_hot & (unbelieved_time[:W] < WAITING_TIME)
        is_back = works[:W] & (estimate.recent_rise > MAX_JUMP) & (rise < -MAX_JUMP)
        is_moved = (is_hot & ~waits) | (is_back & ~believed[:W])
        moved = np.where(is_moved, warmer, 0.0)
        recent_rise = np.where(is_back, 0.0, estimate.recent_rise + moved)
        # T and V of a wire share the error of its moved reading.
        shared = np.zeros((len(self._decay), W))
        shared[:W] = shared[model.size - W : model.size] = np.diag(moved)
        P = estimate.covariance + shared @ shared.T

        # Correct by the Kalman gain of the readings that are used.
        spread = C @ P @ C.T + np.diag(self._reading_variances)
        used = believed.copy()
        used[:W] |= is_moved
        C = C[used]
        gain = np.linalg.solve(spread[np.ix_(used, used)], C @ P).T
        P = P - gain @ C @ P
        heat, heating_rate, drift, lasting, residual = self._split(gain @ innovations[used])
        corrected = StateEstimate(
            estimate.heat + heat,
            # A frozen thermocouple has corrupted this rate.
            np.where(is_frozen, 0.0, estimate.heating_rate + heating_rate),
            estimate.drift + drift,
            estimate.lasting + lasting,
            estimate.residual + residual,
            covariance=(P + P.T) / 2,
            unbelieved_time=unbelieved_time,
            unchanged_time=unchanged_time,
            unread_change=unread_change,
            recent_rise=np.exp(-period / RAISED_TIME) * recent_rise,
            reading_excess=np.where(waits, warmer, 0.0),
            last_readings=np.where(np.isfinite(read), read, estimate.last_readings),
        )

        # Forget the offsets of bends that have read otherwise for a while.
        forget = works[W:] & (unbelieved_time[W:] > FORGET_TIME)
        forget &= np.abs(bend_angle - estimate.last_readings[W:]) < FORGET_MAX_JUMP
        return self._forget_bends(corrected, forget) if forget.any() else corrected

    def _forget_bends(self, estimate: StateEstimate, bends: np.ndarray) -> StateEstimate:
        """Return the estimate with d, p and r of some bends (F,) forgotten."""
        kept = np.full(len(self._decay), True)
        kept[-3 * len(bends) :] = np.tile(~bends, 3)
        covariance = np.where(np.outer(kept, kept), estimate.covariance, 0.0)
        covariance[np.diag_indices_from(covariance)] += np.where(kept, 0.0, self._initial**2)
        none = {name: np.where(bends, 0.0, getattr(estimate, name)) for name in BEND_FIELDS}
        return dataclasses.replace(estimate, covariance=covariance, **none)

    def predict(self, estimate: StateEstimate, duty: np.ndarray) -> StateEstimate:
        """Return the estimate a period later under duty (W,), without new readings."""
        H = self.model.size
        W = self.model.num_wires
        period = self.model.period
        # The heat a period later, and the derivatives of all that is estimated (M, M).
        heat, by_heat, _ = self.model.linearized_step(estimate.heat, duty)
        heat[:W] += period * estimate.heating_rate
        slopes = np.diag(self._decay)
        slopes[:H, :H] = by_heat
        slopes[:W, H : H + W] = period * np.eye(W)
        # Heating makes the wires' temperatures less certain; changes of them, the residual.
        change = heat[:W] - estimate.heat[:W]
        walk = self._walk.copy()
        walk[:W] += (HEATING_ERROR * self._heating * duty) ** 2 / period
        walk[-self.model.num_bends :] = self._residual_walk(change)
        _, rate_decay, drift_decay, _, residual_decay = self._split(self._decay)
        return dataclasses.replace(
            estimate,
            heat=heat,
            heating_rate=rate_decay * estimate.heating_rate,
            drift=drift_decay * estimate.drift,
            residual=residual_decay * estimate.residual,
            covariance=slopes @ estimate.covariance @ slopes.T + np.diag(walk),
            unread_change=estimate.unread_change + heat[:W] - estimate.heat[:W],
        )

    def _residual_walk(self, change: np.ndarray) -> np.ndarray:
        """Return the variance (F,), rad², that r gains while the wires' T changes (W,), °C."""
        path = np.abs(self.model.bend_by_temperature) @ np.abs(change)
        return self._residual_rate * path

    def unexplained(self, recording: Recording) -> tuple[float, float]:
        """Return how long, s, a limb's bend was read to be otherwise than explained.

        The recording is at 20 Hz and begins at rest. The bend that the model does not explain,
        p + r + d, is then more than two standard deviations of what is expected before any bend is
        read: of the rest angle, the sensor's drift, and the model's residual at wires whose heat
        has changed so much.

        Returns:
            The longest time without a break, s, and the largest p + r + d of any bend then, rad.
        """
        W = self.model.num_wires
        drift = self._split(self._initial)[2]
        variance_at_rest = self._rest_error**2 + drift**2
        decay = np.exp(-2 * self.model.period / RESIDUAL_TIME)
        residual_variance: np.ndarray | float = 0.0
        time = largest = 0.0
        longest = (0.0, 0.0)
        vector = self.nothing
        for readings, bend, duty in zip(
            recording.measured_temperature.T, recording.bend_angle.T, recording.duty.T, strict=True
        ):
            # Extend the time in which the bend is unexplained, or end it.
            estimate = self.read(vector, readings, bend)
            off = np.abs(estimate.offset + estimate.drift)
            deviation = np.sqrt(variance_at_rest + residual_variance)
            is_unexplained = (off > EXPLAINED_DEVIATIONS * deviation).any()
            time = time + self.model.period if is_unexplained else 0.0
            largest = max(largest, off.max()) if time else 0.0
            longest = max(longest, (time, float(largest)))
            # Changes of the heat let the residual grow.
            ahead = self.predict(estimate, duty)
            growth = self._residual_walk(ahead.heat[:W] - estimate.heat[:W])
            residual_variance = decay * residual_variance + growth
            vector = pack(ahead)
        return longest

    def bend_angle(self, estimate: StateEstimate) -> np.ndarray:
        """Return φ(x) + p + r (F,), rad, without the sensors' noise and drift."""
        return self.model.bend_angle(estimate.heat) + estimate.offset

    def _split(self, means: np.ndarray) -> list[np.ndarray]:
        """Split a vector (M,) into its parts for [x, V] (H), q (W), d (F), p (F) and r (F)."""
        model = self.model
        sizes = model.size, model.num_wires, model.num_bends, model.num_bends
        return np.split(means, np.cumsum(sizes))

    def _without_sensor_errors(self, bend_angle: np.ndarray) -> np.ndarray:
        """Return the bends (F,), rad, without the gain, offset and roll of the sensors."""
        segments = zip(self.parameters.segments, self._bends_of, strict=True)
        bends = [segment.bend_sensor.unrolled_bends(bend_angle[bend]) for segment, bend in segments]
        return np.concatenate(bends)

    def _measurement_model(self, heat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return φ(x) (F,), rad, and the derivatives C (W + F, M) of readings by all estimates."""
        H = self.model.size
        W = self.model.num_wires
        F = self.model.num_bends
        bend, slopes = self.model.bend_slopes(heat)
        C = np.zeros((W + F, len(self._decay)))
        C[:W, H - W : H] = np.eye(W)
        C[W:, :H] = slopes
        C[W:, H + W :] = np.tile(np.eye(F), 3)
        return bend, C


class LimbObserver(LeafSystem):
    """An extended Kalman filter for a limb of W wires and F bends, with any wire law.

    Its outputs are predictions for the next readings, from the readings so far.

    - input 0 ``duty``: D (W), in [0, 1], that the limb gets
    - input 1 ``measured_temperature``: V (W), °C; NaN where there is no reading
    - input 2 ``bend_angle``: φ (F), rad, as read; NaN where there is no reading
    - output 0 ``wire_temperature``: T (W), °C
    - output 1 ``temperature_deviation``: standard deviation of T (W), °C
    - output 2 ``heat``: [x, V] (H), the states of the wires' laws and the readings
    - output 3 ``bend_angle``: φ (F), rad, without the sensors' noise and drift
    - output 4 ``sensor_drift``: d (F), rad
    - output 5 ``torque_disturbance``: from outside, on each joint that makes a bend (F), N·m
    - output 6 ``believed``: 1 for each thermocouple (W) and bend (F), or 0 if its last
      reading cannot be explained
    - output 7 ``highest_temperature``: largest T within the next second (W), °C, if the duty stays
    - state, discrete, at 20 Hz: the `StateEstimate`, NaN before the first readings
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters):
        """
        Args:
            parameters: description of the limb.

        Raises:
            ParameterError: if a parameter is out of its range.
        """
        super().__init__()
        parameters = LimbParameters.of(parameters)
        self._estimator = Estimator(parameters)
        self._ahead = ReducedModel(parameters, PREDICTION_TIMES[0])
        model = self._estimator.model
        H = model.size
        W = model.num_wires
        F = model.num_bends
        # The duty and the readings, which the state's update reads.
        self.DeclareVectorInputPort("duty", W)
        self.DeclareVectorInputPort("measured_temperature", W)
        self.DeclareVectorInputPort("bend_angle", F)
        state = self.DeclareDiscreteState(self._estimator.nothing)
        # Outputs of the estimate alone, and a prediction that needs the duty.
        estimated = weak_method(self._estimate)
        for name, size, calc in (
            ("wire_temperature", W, lambda e: e.heat[:W]),
            ("temperature_deviation", W, lambda e: np.sqrt(np.diag(e.covariance)[:W])),
            ("heat", H, lambda e: e.heat),
            ("bend_angle", F, self._estimator.bend_angle),
            ("sensor_drift", F, lambda e: e.drift),
            ("torque_disturbance", F, lambda e: e.offset / model.bend_by_torque),
            ("believed", W + F, lambda e: (e.unbelieved_time == 0).astype(float)),
        ):
            self.DeclareVectorOutputPort(
                name,
                size,
                lambda context, output, calc=calc: output.SetFromVector(calc(estimated(context))),
                {self.discrete_state_ticket(state)},
            )
        self.DeclareVectorOutputPort(
            "highest_temperature", W, weak_method(self._calc_highest_temperature)
        )
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _estimate(self, context) -> StateEstimate:
        vector = context.get_discrete_state(0).value()
        if np.isnan(vector).any():
            readings, bend = (self.get_input_port(index).Eval(context) for index in (1, 2))
            return self._estimator.begin(readings, bend)
        return self._estimator.unpack(vector)

    def _update(self, context, state) -> None:
        duty, readings, bend = (self.get_input_port(index).Eval(context) for index in range(3))
        estimate = self._estimator.read(state.value(0), readings, bend)
        state.set_value(pack(self._estimator.predict(estimate, duty)))

    def _calc_highest_temperature(self, context, output) -> None:
        estimate = self._estimate(context)
        duty = self.get_input_port(0).Eval(context)
        W = self._ahead.num_wires
        heats = [estimate.heat]
        for _ in PREDICTION_TIMES:
            heats.append(self._ahead.step(heats[-1], duty))
            heats[-1][:W] += PREDICTION_TIMES[0] * estimate.heating_rate
        output.SetFromVector(np.max(heats, axis=0)[:W])

"""What the sensors tell about a limb: an extended Kalman filter on `ReducedModel`.

It estimates the heat [x, V] (H) of W wires and what the model leaves out of them and of
F bends: a heating rate q (W), by which the wires warm faster than their law
says (another supply voltage, a fan, a room that is warmer); the drift d (F) of the
bend sensors; a bend p (F) that lasts, of a torque from outside, such as a payload's, or of a rest
angle that is not known; and the residual r (F) of the model's bend, which comes and goes as the
wires' heat changes:

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

AHEAD = (0.25, 0.5, 0.75, 1.0)  # s, at which the observer predicts temperatures

GATE = 5.0  # standard deviations, beyond which a reading is not believed
LARGEST_OFFSET = np.deg2rad(20.0)  # rad, of p and d; a bend further from the model is not believed
# s, after which what is read to be equal to the last bit is not believed, of bend sensors and of
# thermocouples, whose steps are coarse. A wire at rest may be read so: then nothing is lost.
STUCK_TIME, STUCK_READING_TIME = 0.5, 2.0
STUCK_CHANGE = 5.0  # °C, by which a wire warms or cools while its reading is equal to the last bit
# °C, by which no wire's reading changes from one to the next, as boards have it. One that is too
# hot since it rose so is believed after so many s; that it was is forgotten within so many s.
LARGEST_JUMP, WAITING_TIME, RAISED_TIME = 10.0, 3.0, 30.0
# s, after which p and d are forgotten if the bend reads otherwise: what bent the limb, or a fault
# of the sensor that they came from, has gone; but not while it jumps by so much, rad.
FORGET_TIME, JUMP = 0.5, np.deg2rad(5.0)

# The noise of thermocouples with steps of 0.25 °C that are read at 10 Hz and used at 20 Hz.
READING_NOISE = 0.4  # °C
# What laws miss, as random walks: standard deviations after one second.
TEMPERATURE_WALK = 0.5  # °C, of states that are temperatures
READING_WALK = 0.1  # °C
OTHER_WALK = 0.005  # of the typical change of other states
HEATING_ERROR = 0.1  # of the heating by duty, in addition
BEND_WALK = np.deg2rad(0.1)  # rad, of p
# r changes by the calibration's mean error of bends, or by so much if that is not known, rad, while
# wires bend the limb by so much in all, to and fro, rad. So the bends of calibrated limbs of three
# emulated physics are known best, now and seconds ahead. It is forgotten within so many s.
UNKNOWN_BEND_ERROR, RESIDUAL_PATH, RESIDUAL_TIME = np.deg2rad(1.0), np.deg2rad(20.0), 20.0
HEATING_RATE, HEATING_TIME = 1.0, 15.0  # °C/s and s, of q
DRIFT_TIME = 120.0  # s, in which the correlation of d falls to 1/e
# rad, of p where the rest angle is not known, or bent by more than so many standard deviations.
INITIAL_BEND, UNLOADED = np.deg2rad(3.0), 2.0
INITIAL_TEMPERATURE = 1.0  # °C
UNEXPLAINED = 2.0  # standard deviations, by which a bend is read from where the model explains it
# °C, by which the silicone around a warm wire may be off, and what other states are known to.
SILICONE = 5.0

OF_BENDS = ("drift", "lasting", "residual")  # what a `StateEstimate` has of each bend

Record = TypeVar("Record")


@dataclasses.dataclass(frozen=True, eq=False)
class StateEstimate:
    """What is known of a limb at a time.

    - ``heat``: [x, V] (H).
    - ``heating_rate``: q (W), °C/s.
    - ``drift``: d (F), rad.
    - ``lasting``: p (F), rad.
    - ``residual``: r (F), rad.
    - ``covariance``: covariance of the five above, in this order (M, M).
    - ``unbelieved``: time since each thermocouple and bend was last believed (W + F), s.
    - ``alike``: time since each reading last changed (W + F), s.
    - ``unshown``: change of each wire's temperature since its reading changed (W), °C.
    - ``raised``: recent rise of the estimate to readings that were too hot (W), °C.
    - ``hotter``: excess of readings that are too hot and not believed yet (W), °C.
    - ``last``: last readings (W + F), °C and rad.
    """

    heat: np.ndarray
    heating_rate: np.ndarray
    drift: np.ndarray
    lasting: np.ndarray
    residual: np.ndarray
    covariance: np.ndarray
    unbelieved: np.ndarray
    alike: np.ndarray
    unshown: np.ndarray
    raised: np.ndarray
    hotter: np.ndarray
    last: np.ndarray

    @property
    def offset(self) -> np.ndarray:
        """p + r (F,), rad: how much further the limb is bent than the model."""
        return self.lasting + self.residual


def packed(record: Any) -> np.ndarray:
    """Return a dataclass of arrays and numbers as one vector, for a system's discrete state."""
    return np.concatenate([np.ravel(value) for value in vars(record).values()])


def unpacked(vector: np.ndarray, like: Record) -> Record:
    """Return the dataclass in a `packed` vector, whose fields have the shapes of ``like``."""
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
        H, W, F, h = model.size, model.num_wires, model.num_bends, model.period
        layout = limb.layout
        record = parameters.calibration
        sensors = [parameters.segments[s].bend_sensor for s in layout.bend_segment]
        self._bends_of = layout.bends_of
        noise = np.maximum([sensor.noise for sensor in sensors], np.deg2rad(0.1))
        drift = np.array([sensor.drift for sensor in sensors])
        self._reading_variances = np.concatenate([np.full(W, READING_NOISE), noise]) ** 2
        temperatures = model.scales >= 10.0
        walks = np.where(temperatures, TEMPERATURE_WALK, OTHER_WALK * model.scales)
        walks[-W:] = READING_WALK

        def means(heat, rate, drift, bend, residual):
            return np.concatenate(
                [heat, np.full(W, rate), drift, np.full(F, bend), np.full(F, residual)]
            )

        rate_walk, drift_walk = 2 * HEATING_RATE**2 / HEATING_TIME, 2 * drift**2 / DRIFT_TIME
        self._walk = h * means(walks**2, rate_walk, drift_walk, BEND_WALK**2, 0.0)
        decays = np.exp(-h / HEATING_TIME), np.full(F, np.exp(-h / DRIFT_TIME))
        self._decay = means(np.zeros(H), *decays, 1.0, np.exp(-h / RESIDUAL_TIME))
        error = (record and record.bend_error) or UNKNOWN_BEND_ERROR
        self._residual_rate = error**2 / RESIDUAL_PATH  # rad² per rad of bend, to and fro
        initial = np.where(temperatures, SILICONE, 0.0)
        initial[:W] = initial[-W:] = INITIAL_TEMPERATURE
        self._initial = means(initial, HEATING_RATE / 2, drift, INITIAL_BEND, 0.0)
        self._others = np.flatnonzero(~temperatures)
        # How far limbs may rest, without a load, from where their parameters say.
        self._rest_error = np.full(F, INITIAL_BEND)
        for direction, name in enumerate(["rest_angle", "rest_angle_e3"]):
            if record is not None and name in record.names:
                error = record.standard_errors[record.names.index(name)]
                self._rest_error[layout.bend_direction == direction] = error
        self._heating = model.period * model.heating_rates  # °C per step, by full duty
        self._like = self.begin(np.full(W, np.nan), np.full(F, np.nan))
        self.nothing = np.full_like(packed(self._like), np.nan)

    def begin(self, readings: np.ndarray, bend_angle: np.ndarray) -> StateEstimate:
        """Return the estimate for a limb at rest, whose silicone is as warm as its wires.

        What the bend is off then is taken for the sensor's drift and the rest angle's error, as
        far as both are known to be so large; no reading tells them from a payload. If it is off
        by more, it is a payload.

        Args:
            readings: V (W), °C; NaN where there is none.
            bend_angle: readings of the bend sensors (F), rad; NaN where there is none.
        """
        W, F = self.model.num_wires, self.model.num_bends
        known = np.where(np.isfinite(readings), readings, self.model.cold[-W:])
        heat = self.model.rested(known)
        initial = self._initial.copy()
        initial[self._others] = (self.model.rested(known + SILICONE) - heat)[self._others]
        lasting = initial[-2 * F : -F]
        lasting[:] = self._rest_error
        held, C = self._sensing(heat)
        spread = ((C[W:] * initial) ** 2).sum(axis=1) + self._reading_variances[W:]
        off = np.abs(self._corrected(bend_angle) - held)
        lasting[off > UNLOADED * np.sqrt(spread)] = INITIAL_BEND
        return StateEstimate(
            heat,
            np.zeros(W),
            np.zeros(F),
            np.zeros(F),
            np.zeros(F),
            np.diag(initial**2),
            unbelieved=np.zeros(W + F),
            alike=np.zeros(W + F),
            unshown=np.zeros(W),
            raised=np.maximum(known - self.model.cold[-W:], 0.0),
            hotter=np.zeros(W),
            last=np.concatenate([known, np.nan_to_num(bend_angle)]),
        )

    def loaded(self, heat: np.ndarray, bend_angle: np.ndarray) -> StateEstimate:
        """Return the estimate for a limb at rest with known heat, which a load bends otherwise.

        Args:
            heat: [x, V] (H).
            bend_angle: φ (F), rad, with the load.
        """
        W = self.model.num_wires
        estimate = self.begin(heat[-W:], np.full(self.model.num_bends, np.nan))
        return dataclasses.replace(
            estimate, heat=heat, lasting=bend_angle - self.model.bend_angle(heat)
        )

    def read(
        self, vector: np.ndarray, readings: np.ndarray, bend_angle: np.ndarray
    ) -> StateEstimate:
        """Return the estimate `corrected` by readings, from a packed one; `begin` if it is NaN."""
        if np.isnan(vector).any():
            return self.begin(readings, bend_angle)
        return self.corrected(self.unpacked(vector), readings, bend_angle)

    def unpacked(self, vector: np.ndarray) -> StateEstimate:
        """Return the estimate in a `packed` vector."""
        return unpacked(vector, self._like)

    def corrected(
        self, estimate: StateEstimate, readings: np.ndarray, bend_angle: np.ndarray
    ) -> StateEstimate:
        """Return the estimate after readings, as for `begin`, as far as they are believed.

        A thermocouple that is hotter than expected is believed beyond the gate, too, as no wire
        must suffer from a wrong estimate: its wire is so much hotter altogether. If it jumped
        there, it has to stay first, and is believed when it jumps back.
        """
        model, W, F = self.model, self.model.num_wires, self.model.num_bends
        read = np.concatenate([readings, bend_angle])
        same = read == estimate.last
        alike = np.where(same, estimate.alike + model.period, 0.0)
        unshown = np.where(same[:W], estimate.unshown, 0.0)
        frozen = np.abs(unshown) > STUCK_CHANGE
        works = np.isfinite(read) & (alike < np.repeat([STUCK_READING_TIME, STUCK_TIME], [W, F]))
        works[:W] &= ~frozen
        held, C = self._sensing(estimate.heat)
        bend = self._corrected(bend_angle)
        predicted = held + estimate.offset + estimate.drift
        innovations = np.concatenate([readings - model.readings(estimate.heat), bend - predicted])
        spread = C @ estimate.covariance @ C.T + np.diag(self._reading_variances)
        gate = GATE * np.sqrt(np.diag(spread))
        believed = works & (np.abs(innovations) < gate)
        believed[W:] &= np.abs(bend - held) < LARGEST_OFFSET
        unbelieved = np.where(believed, 0.0, estimate.unbelieved + model.period)
        warmer, rise = innovations[:W], readings - estimate.last[:W]
        hot = works[:W] & (warmer >= gate[:W])
        waits = (rise > LARGEST_JUMP) | (estimate.hotter > 0.0)
        waits &= hot & (unbelieved[:W] < WAITING_TIME)
        back = works[:W] & (estimate.raised > LARGEST_JUMP) & (rise < -LARGEST_JUMP)
        moved = (hot & ~waits) | (back & ~believed[:W])
        raised = np.where(back, 0.0, estimate.raised + np.where(moved, warmer, 0.0))
        P = estimate.covariance + self._altogether(np.where(moved, warmer, 0.0))
        spread = C @ P @ C.T + np.diag(self._reading_variances)
        used = believed.copy()
        used[:W] |= moved
        C, innovations = C[used], innovations[used]
        gain = np.linalg.solve(spread[np.ix_(used, used)], C @ P).T
        P = P - gain @ C @ P
        heat, heating_rate, drift, lasting, residual = self._split(gain @ innovations)
        corrected = StateEstimate(
            estimate.heat + heat,
            # What a frozen thermocouple said of it is forgotten.
            np.where(frozen, 0.0, estimate.heating_rate + heating_rate),
            estimate.drift + drift,
            estimate.lasting + lasting,
            estimate.residual + residual,
            covariance=(P + P.T) / 2,
            unbelieved=unbelieved,
            alike=alike,
            unshown=unshown,
            raised=np.exp(-model.period / RAISED_TIME) * raised,
            hotter=np.where(waits, warmer, 0.0),
            last=np.where(np.isfinite(read), read, estimate.last),
        )
        forget = works[W:] & (unbelieved[W:] > FORGET_TIME)
        forget &= np.abs(bend_angle - estimate.last[W:]) < JUMP
        return self._forgetting(corrected, forget) if forget.any() else corrected

    def _altogether(self, warmer: np.ndarray) -> np.ndarray:
        """Covariance (M, M) of wires that may be so much warmer (W,), °C, and read so."""
        H, W = self.model.size, self.model.num_wires
        together = np.zeros((len(self._decay), W))
        together[:W] = together[H - W : H] = np.diag(warmer)
        return together @ together.T

    def _forgetting(self, estimate: StateEstimate, bends: np.ndarray) -> StateEstimate:
        """Return the estimate with d, p and r of some bends (F,) forgotten."""
        kept = np.full(len(self._decay), True)
        kept[-3 * len(bends) :] = np.tile(~bends, 3)
        covariance = np.where(np.outer(kept, kept), estimate.covariance, 0.0)
        covariance[np.diag_indices_from(covariance)] += np.where(kept, 0.0, self._initial**2)
        none = {name: np.where(bends, 0.0, getattr(estimate, name)) for name in OF_BENDS}
        return dataclasses.replace(estimate, covariance=covariance, **none)

    def predicted(self, estimate: StateEstimate, duty: np.ndarray) -> StateEstimate:
        """Return the estimate a period later under duty (W,), without new readings."""
        H, W, period = self.model.size, self.model.num_wires, self.model.period
        heat, by_heat, _ = self.model.linearized_step(estimate.heat, duty)
        heat[:W] += period * estimate.heating_rate
        F = np.diag(self._decay)
        F[:H, :H] = by_heat
        F[:W, H : H + W] = period * np.eye(W)
        walk = self._walk.copy()
        walk[:W] += (HEATING_ERROR * self._heating * duty) ** 2 / period
        walk[-self.model.num_bends :] = self._residual_walk(heat[:W] - estimate.heat[:W])
        P = F @ estimate.covariance @ F.T + np.diag(walk)
        unshown = estimate.unshown + heat[:W] - estimate.heat[:W]
        _, rate_left, drift_left, _, residual_left = self._split(self._decay)
        return dataclasses.replace(
            estimate,
            heat=heat,
            heating_rate=rate_left * estimate.heating_rate,
            drift=drift_left * estimate.drift,
            residual=residual_left * estimate.residual,
            covariance=P,
            unshown=unshown,
        )

    def _residual_walk(self, change: np.ndarray) -> np.ndarray:
        """Variance (F,), rad², that r gains while wires' T changes (W,), °C."""
        path = np.abs(self.model.bend_by_temperature) @ np.abs(change)
        return self._residual_rate * path

    def unexplained(self, recording: Recording) -> tuple[float, float]:
        """Return for how long, s, a limb was read to be bent otherwise than explained.

        The recording is at 20 Hz and begins at rest. The bend that the model does not explain,
        p + r + d, is then more than two standard deviations of what is known before any bend is
        read: of the rest angle, the sensor's drift, and the model's residual at wires whose heat
        has changed so much.

        Returns:
            The longest time without a break, s, and the largest p + r + d of any bend then, rad.
        """
        W, drift = self.model.num_wires, self._split(self._initial)[2]
        still = self._rest_error**2 + drift**2
        fades = np.exp(-2 * self.model.period / RESIDUAL_TIME)
        vector, residual, time, largest, found = self.nothing, 0.0, 0.0, 0.0, (0.0, 0.0)
        for readings, bend, duty in zip(
            recording.measured_temperature.T, recording.bend_angle.T, recording.duty.T, strict=True
        ):
            estimate = self.read(vector, readings, bend)
            off = np.abs(estimate.offset + estimate.drift)
            beyond = off > UNEXPLAINED * np.sqrt(still + residual)
            time = time + self.model.period if beyond.any() else 0.0
            largest = max(largest, off.max()) if time else 0.0
            found = max(found, (time, float(largest)))
            ahead = self.predicted(estimate, duty)
            residual = fades * residual + self._residual_walk(ahead.heat[:W] - estimate.heat[:W])
            vector = packed(ahead)
        return found

    def bend_angle(self, estimate: StateEstimate) -> np.ndarray:
        """φ(x) + p + r (F,), rad, without the sensors' noise and drift."""
        return self.model.bend_angle(estimate.heat) + estimate.offset

    def _split(self, means: np.ndarray) -> list[np.ndarray]:
        """Parts of a vector (M,) that belong to [x, V] (H), q (W), d (F), p (F) and r (F)."""
        model = self.model
        sizes = model.size, model.num_wires, model.num_bends, model.num_bends
        return np.split(means, np.cumsum(sizes))

    def _corrected(self, bend_angle: np.ndarray) -> np.ndarray:
        """Bends (F,), rad, as sensors without gain, offset and roll would read them."""
        bends = [
            segment.bend_sensor.unrolled_bends(bend_angle[places])
            for segment, places in zip(self.parameters.segments, self._bends_of, strict=True)
        ]
        return np.concatenate(bends)

    def _sensing(self, heat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """φ(x) (F,), rad, and derivatives (W + F, M) of readings by all that is estimated."""
        H, W, F = self.model.size, self.model.num_wires, self.model.num_bends
        held, slopes = self.model.bend_slopes(heat)
        C = np.zeros((W + F, len(self._decay)))
        C[:W, H - W : H] = np.eye(W)
        C[W:, :H] = slopes
        C[W:, H + W :] = np.tile(np.eye(F), 3)
        return held, C


class LimbObserver(LeafSystem):
    """An extended Kalman filter for a limb of W wires and F bends, with any wire law.

    Its outputs are what is expected at the next readings, from those so far.

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
    - output 7 ``highest_temperature``: largest T within the next second (W), °C, if the duty
      stays
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
        self._ahead = ReducedModel(parameters, AHEAD[0])
        model = self._estimator.model
        H, W, F = model.size, model.num_wires, model.num_bends
        self.DeclareVectorInputPort("duty", W)
        self.DeclareVectorInputPort("measured_temperature", W)
        self.DeclareVectorInputPort("bend_angle", F)
        state = self.DeclareDiscreteState(self._estimator.nothing)
        for name, size, calc in (
            ("wire_temperature", W, lambda e: e.heat[:W]),
            ("temperature_deviation", W, lambda e: np.sqrt(np.diag(e.covariance)[:W])),
            ("heat", H, lambda e: e.heat),
            ("bend_angle", F, self._estimator.bend_angle),
            ("sensor_drift", F, lambda e: e.drift),
            ("torque_disturbance", F, lambda e: e.offset / model.bend_by_torque),
            ("believed", W + F, lambda e: (e.unbelieved == 0).astype(float)),
        ):
            self.DeclareVectorOutputPort(
                name, size, self._shown(calc), {self.discrete_state_ticket(state)}
            )
        self.DeclareVectorOutputPort(
            "highest_temperature", W, weak_method(self._calc_highest_temperature)
        )
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _shown(self, calc):
        estimate = weak_method(self._estimate)
        return lambda context, output: output.SetFromVector(calc(estimate(context)))

    def _estimate(self, context) -> StateEstimate:
        vector = context.get_discrete_state(0).value()
        if np.isnan(vector).any():
            readings, bend = (self.get_input_port(index).Eval(context) for index in (1, 2))
            return self._estimator.begin(readings, bend)
        return self._estimator.unpacked(vector)

    def _update(self, context, state) -> None:
        duty, readings, bend = (self.get_input_port(index).Eval(context) for index in range(3))
        estimate = self._estimator.read(state.value(0), readings, bend)
        state.set_value(packed(self._estimator.predicted(estimate, duty)))

    def _calc_highest_temperature(self, context, output) -> None:
        estimate, duty = self._estimate(context), self.get_input_port(0).Eval(context)
        W, heats = self._ahead.num_wires, [estimate.heat]
        for _ in AHEAD:
            heats.append(self._ahead.step(heats[-1], duty))
            heats[-1][:W] += AHEAD[0] * estimate.heating_rate
        output.SetFromVector(np.max(heats, axis=0)[:W])

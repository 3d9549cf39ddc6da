"""All wires of a limb at once: their laws, element by element over any number of points."""

import copy
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, Variable

from limb_systems.model.derivatives import CompiledFunction, Part, SideBySide
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.rubber import REST_SCALE, NonlinearRubber, num_rest_shifts, ramp
from limb_systems.model.wire_law import TEMPERATURE_SCALE, WireLaw, runge_kutta, within

LONGEST_STEP = 0.1  # s, of an integration


@dataclasses.dataclass(frozen=True)
class _Alike:
    """Wires with laws of one class.

    - ``law``: one law whose fields are arrays with an element for each wire.
    - ``wires``: indices of the wires among all wires.
    - ``states``: indices among all states, for each of the law's states.
    """

    law: WireLaw
    wires: slice | np.ndarray
    states: list[slice | np.ndarray]


class Wires:
    """The W wires of a limb in its rubber, with N states in all.

    The states are the wire temperatures T (W) in the order of the wires, then
    the other states of their laws: the second state of all wires, the third,
    and so on. Those of `NonlinearRubber` are the last, if its rest angle has a memory.
    Arrays have the states, the wires or the joints along their last
    axis and any number of points before it.

    - ``num_wires``, ``num_states``: W and N.
    - ``state_names``: such as ``S_left``, N.
    - ``heat_scales``: typical changes of the states and of the readings (N + W,).
    - ``cold_states``: states of wires that were never heated (N,).
    - ``settles``: true where a state is no memory (N,).
    - ``levers``: B, direction of the wires' torque on the joints (n, W), as of `Layout`.
    - ``rates_are_affine``: whether heat rates are affine in states, readings and duty.
    - ``torque_is_affine``: whether forces are affine in the states, and no function of the angle.
    - ``laws_need_angle``: whether the torque of any law depends on the angle that its wire sees.
    - ``torque_needs_angle``: whether any force does, also that of the rubber.
    - ``heat_pattern``: true where `heat_rates` depend on [x, V, D] (N + W, N + 2W).
    - ``heat_curvature``: true where a pair of [x, V, D] may have a second derivative in
      `heat_rates` (N + 2W, N + 2W).
    - ``torque_curvature``: true where a pair of states may have a second derivative in
      `forces` (N, N).

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        laws = [wire.law for wire in parameters.wires]
        self.num_wires = len(laws)
        self._ambient = parameters.ambient_temperature
        columns: list[list[int]] = [[] for _ in laws]
        names: list[str] = []
        scales: list[float] = []
        cold: list[float] = []
        ranges: list[tuple[float, float]] = []
        remembers: list[bool] = []
        for number in range(max(len(law.states) for law in laws)):
            for index, (law, name) in enumerate(zip(laws, parameters.wire_names, strict=True)):
                if number < len(law.states):
                    state, scale = list(law.states.items())[number]
                    columns[index].append(len(names))
                    names.append(f"{state}_{name}")
                    scales.append(scale)
                    cold.append(law.cold_states(self._ambient)[number])
                    ranges.append(law.memory.get(state, (-np.inf, np.inf)))
                    remembers.append(state in law.memory)
        self._rubber = rubber = NonlinearRubber(parameters)
        self._first_shift, num_shifts = len(names), len(rubber.state_names)
        names += rubber.state_names
        scales += [REST_SCALE] * num_shifts
        cold += [0.0] * num_shifts
        self.num_states, self.state_names = len(names), names
        self.heat_scales = np.array(scales + [TEMPERATURE_SCALE] * self.num_wires)
        self.cold_states = np.array(cold, float)
        ranges += [(-np.inf, np.inf)] * num_shifts
        self._ranges = np.array(ranges).T
        self.settles = ~np.array([*remembers, *[True] * num_shifts])
        self._groups = []
        for kind in dict.fromkeys(map(type, laws)):
            wires = [index for index, law in enumerate(laws) if type(law) is kind]
            self._groups.append(
                _Alike(
                    _stacked([laws[index] for index in wires]),
                    _as_slice(wires),
                    [
                        _as_slice([columns[index][k] for index in wires])
                        for k in range(len(columns[wires[0]]))
                    ],
                )
            )
        layout = Layout(parameters)
        self.levers, self._links = layout.levers, layout.link_of_joint
        self._first_joints = np.append(0, layout.last_joints[:-1] + 1)
        self._compile()
        N = self.num_states
        self.torque_curvature = self._torque.curvature[:N, :N]
        self.laws_need_angle = bool(self._torque.pattern[:, N:].any())
        self.rates_are_affine = not self.heat_curvature.any()
        self.torque_needs_angle = self.laws_need_angle or rubber.stiffens
        self.torque_is_affine = not (self.torque_needs_angle or self.torque_curvature.any())
        zero = np.zeros(N + 2 * self.num_wires)
        if self.rates_are_affine:
            _, self._heat_slopes = self._expanded(zero)
        if self.torque_is_affine:
            straight = np.zeros(len(self.levers))
            self._force_slopes, _ = self._force_derivatives(zero[:N], straight)

    def rates(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """ẋ (..., N) of the states (..., N) under the duty (..., W), per second."""
        if states.dtype == duty.dtype == float:
            shape = states.shape[:-1]
            if duty.shape[:-1] != shape:
                shape = np.broadcast_shapes(shape, duty.shape[:-1])
            points = np.zeros((*shape, self.num_states + 2 * self.num_wires))
            points[..., : self.num_states] = states
            points[..., -self.num_wires :] = duty
            return self._heat_values(points)[..., : self.num_states]
        result = np.empty(states.shape, np.result_type(states, duty))
        progress = np.empty((*states.shape[:-1], self.num_wires), result.dtype)
        for group in self._groups:
            x = [states[..., column] for column in group.states]
            rates = group.law.rates(x, duty[..., group.wires], self._ambient)
            for column, rate in zip(group.states, rates, strict=True):
                result[..., column] = rate
            if self._rubber.remembers:
                torque_rates = _torque_rate(group.law, x, rates, self._ambient)
                progress[..., group.wires] = self._rubber.progress(torque_rates, group.wires)
        if self._rubber.remembers:
            shifts = slice(self._first_shift, None)
            result[..., shifts] = self._rubber.rates(states[..., shifts], progress)
        return result

    def within(self, states: np.ndarray) -> np.ndarray:
        """States (..., N) kept in the ranges of the laws' ``memory``, which steps may leave."""
        return within(states, *self._ranges)

    def torques(self, states: np.ndarray, angles: np.ndarray | None = None) -> np.ndarray:
        """Torque of each wire (..., W), N·m, as if it ran at +E2.

        With joint angles (..., n) in rad: on each link, (..., L, W), by the angle that each wire
        sees there, t_w = Σ B_jw θ_j over the link's joints.
        """
        if angles is None:
            return self._torques(states, np.zeros(self.num_wires))
        return self._torques(states[..., None, :], self._seen(angles))

    def _seen(self, angles: np.ndarray) -> np.ndarray:
        """Angles (..., L, W) that the wires see on the links, of θ (..., n)."""
        return np.add.reduceat(angles[..., :, None] * self.levers, self._first_joints, axis=-2)

    def _torques(self, states: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Torques (..., W) at states (..., N) and the angles that the wires see (..., W)."""
        shape = np.broadcast_shapes(states.shape[:-1], seen.shape[:-1])
        result = np.empty((*shape, self.num_wires), np.result_type(states, seen))
        for group in self._groups:
            x = [states[..., column] for column in group.states]
            result[..., group.wires] = group.law.torque(x, self._ambient, seen[..., group.wires])
        return result

    def forces(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Generalized force f (..., n) on the joints at the angles (..., n), N·m; eqn (4).

        The force of `NonlinearRubber` is part of it.
        """
        if self.laws_need_angle:
            force = (self.torques(states, angles)[..., self._links, :] * self.levers).sum(axis=-1)
        else:
            force = self.torques(states) @ self.levers.T
        if self._rubber.remembers or self._rubber.stiffens:
            force = force + self._rubber.forces(states[..., self._first_shift :], angles)
        return force

    def reading_rates(self, readings: np.ndarray, states: np.ndarray) -> np.ndarray:
        """V̇ (..., W) of the readings V (..., W), °C/s."""
        result = np.empty(readings.shape, np.result_type(readings, states))
        for group in self._groups:
            x = [states[..., column] for column in group.states]
            result[..., group.wires] = group.law.reading_rate(readings[..., group.wires], x)
        return result

    def heat_rates(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """`rates` and `reading_rates` of heat = [x, V] (..., N + W), side by side."""
        if heat.dtype == duty.dtype == float:
            return self._heat_values(_points(heat, duty))
        states, readings = np.split(heat, [self.num_states], axis=-1)
        return np.concatenate(
            [self.rates(states, duty), self.reading_rates(readings, states)], axis=-1
        )

    def heat_jacobian(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Derivative of `heat_rates` by [x, V, D], (..., N + W, N + W + W).

        If the rates are affine, it is the same at all points and returned
        only once: the axes before the last two have length 1.
        """
        if self.rates_are_affine:
            return self._heat_slopes.reshape((1,) * (heat.ndim - 1) + self._heat_slopes.shape)
        return self.expanded_heat_rates(heat, duty)[1]

    def expanded_heat_rates(
        self, heat: np.ndarray, duty: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """`heat_rates` (..., N + W), and their derivative at each point, as `heat_jacobian`."""
        if not self.rates_are_affine:
            return self._expanded(_points(heat, duty))
        rates, slopes = self.heat_rates(heat, duty), self._heat_slopes
        return rates, np.broadcast_to(slopes, (*rates.shape[:-1], *slopes.shape))

    def _expanded(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        N, W = self.num_states, self.num_wires
        values, slopes = self._heat.first(points)
        rates, by_point = self._whole_rates(points, values), slopes[..., : N + W, :]
        if self._rubber.remembers:
            shifts, own = slice(self._first_shift, N), np.arange(self._first_shift, N)
            by_progress = self._rubber.rates_by_progress(points[..., shifts])
            by_point[..., shifts, :] = by_progress @ slopes[..., N + W :, :]
            by_point[..., own, own] -= values[..., N + W :] @ self._rubber.pace.T
        return rates, by_point

    def _heat_values(self, points: np.ndarray) -> np.ndarray:
        """`heat_rates` at points [x, V, D] (..., N + 2W) of floats."""
        return self._whole_rates(points, self._heat.values(points))

    def _whole_rates(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """`heat_rates` from the values of the laws."""
        if not self._rubber.remembers:
            return values
        rates, progress = np.split(values, [self.num_states + self.num_wires], axis=-1)
        shifts = slice(self._first_shift, self.num_states)
        rates[..., shifts] = self._rubber.rates(points[..., shifts], progress)
        return rates

    def force_derivatives(
        self, states: np.ndarray, angles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Derivatives of `forces` by states (..., n, N), and by angles (..., n, n).

        Where the torque is affine the former has axes of length 1, as that of
        `heat_jacobian`; the latter is None where no torque depends on an angle.
        """
        if self.torque_is_affine:
            return self._force_slopes.reshape(
                (1,) * (states.ndim - 1) + self._force_slopes.shape
            ), None
        return self._force_derivatives(states, angles)

    def _force_derivatives(
        self, states: np.ndarray, angles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        _, by_torque = self._torque.first(self._torque_points(states, angles))
        by_angle, N = None, self.num_states
        if self.laws_need_angle:
            by_torque = by_torque[..., self._links, :, :]
            by_states = np.einsum("nw,...nwk->...nk", self.levers, by_torque[..., :N])
            by_seen = np.einsum("...nww->...nw", by_torque[..., N:]) * self.levers
            by_angle = by_seen @ self.levers.T * (self._links[:, None] == self._links)
        else:
            by_states = self.levers @ by_torque[..., :N]
        by_states[..., self._first_shift :] = self._rubber.force_by_shift
        if self._rubber.stiffens:
            by_angle = self._rubber.force_by_angle(angles) + (0.0 if by_angle is None else by_angle)
        return by_states, by_angle

    def _torque_points(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Points [x, t] (..., N + W) with the angle t that each wire sees, and for each link
        (..., L, N + W) if laws need it."""
        W = self.num_wires
        if not self.laws_need_angle:
            return np.concatenate([states, np.zeros((*states.shape[:-1], W))], axis=-1)
        seen = self._seen(angles)
        states = np.broadcast_to(states[..., None, :], (*seen.shape[:-1], self.num_states))
        return np.concatenate([states, seen], axis=-1)

    def heat_hessian(self, heat: np.ndarray, duty: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `heat_rates` by [x, V, D], (..., N + 2W, N + 2W).

        Args:
            heat, duty: as for `heat_rates`.
            weights: (..., N + W).
        """
        points = _points(heat, duty)
        if not self._rubber.remembers:
            return self._heat.second(points, weights)
        shifts = slice(self._first_shift, self.num_states)
        on_progress = weights[..., None, shifts] @ self._rubber.rates_by_progress(
            points[..., shifts]
        )
        result = self._heat.second(
            points, np.concatenate([weights, on_progress[..., 0, :]], axis=-1)
        )
        by_progress = self._heat.first(points)[1][..., weights.shape[-1] :, :]
        # d² r' / dr dp, which the progress has a part in
        mixed = -(self._rubber.pace @ by_progress) * weights[..., shifts, None]
        result[..., shifts, :] += mixed
        result[..., :, shifts] += mixed.swapaxes(-1, -2)
        return result

    def force_hessian(
        self, states: np.ndarray, angles: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of weights · `forces` by the states (..., N, N), at fixed angles.

        Args:
            states, angles: as for `forces`.
            weights: (..., n).
        """
        # Weights are summed over each link's joints as angles are.
        on_torques = self._seen(weights) if self.laws_need_angle else weights @ self.levers
        N = self.num_states
        result = self._torque.second(self._torque_points(states, angles), on_torques)[..., :N, :N]
        return result.sum(axis=-3) if self.laws_need_angle else result

    def force_hessian_by_angle(self, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `forces` by angles (..., n, n), where rubber stiffens.

        What laws add whose torque depends on the angle is left out.
        """
        return self._rubber.force_hessian(angles, weights)

    def affine_rates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (N, N), B (N, W) and c (N) of ẋ = A x + B D + c.

        They are those of the tangent at cold wires without duty, which is the
        law itself if the rates are affine. The rubber's memory stays as it is:
        at rest, where it begins to follow, a tangent would say nothing.
        """
        N, W = self.num_states, self.num_wires
        cold = np.concatenate([self.cold_states, self.cold_states[:W]])
        slopes = self.heat_jacobian(cold, np.zeros(W)).reshape(N + W, -1)
        slopes[self._first_shift : N] = 0.0
        A, B = slopes[:N, :N], slopes[:N, N + W :]
        return A, B, self.rates(self.cold_states, np.zeros(W)) - A @ self.cold_states

    def under_duty(
        self,
        states: np.ndarray,
        duty: np.ndarray,
        times: np.ndarray,
        longest_step: float = LONGEST_STEP,
    ) -> np.ndarray:
        """The states (K, N) under duty (K, W) at times (K,), s, and linear between.

        By the classical Runge-Kutta method, in steps of half the fastest time constant of
        cold wires at most.

        Args:
            states: states at the first time (N,).
            longest_step: longest step of the integration, s, for states of warm wires
        """
        fastest = np.abs(np.linalg.eigvals(self.affine_rates()[0])).max()
        course = [states]
        for k, length in enumerate(np.diff(times)):
            num_steps = int(np.ceil(length * max(2 * fastest, 1 / longest_step) - 1e-9))
            shares = np.linspace(0, 1, 2 * num_steps + 1)[:, None]
            levels = duty[k] + shares * (duty[k + 1] - duty[k])
            for step in range(num_steps):
                ends = levels[2 * step : 2 * step + 3]
                states = self.within(runge_kutta(self.rates, states, ends, length / num_steps))
            course.append(states)
        return np.array(course)

    def settled_states(self, temperature: np.ndarray) -> np.ndarray:
        """The states (N,) of cold wires that were heated to T (W,), °C, until they settled.

        The laws' ``memory`` is as their `warm_states` say; that of the rubber as if
        all wires were heated at once.
        """
        W, N = self.num_wires, self._first_shift
        states, duty = self.cold_states.copy(), np.zeros(W)
        for group in self._groups:
            warm = group.law.warm_states(temperature[group.wires], self._ambient)
            for column, values in zip(group.states, warm, strict=True):
                states[column] = values
        for _ in range(20 if N > W else 0):
            # The duty that holds T, then the other states while it does.
            heat = np.concatenate([states, temperature])
            slopes = self.heat_jacobian(heat, duty).reshape(len(heat), -1)
            duty = duty - np.linalg.pinv(slopes[:W, -W:]) @ self.rates(states, duty)[:W]
            slopes = self.heat_jacobian(heat, duty).reshape(len(heat), -1)
            held = slopes[W:N, -W:] @ np.linalg.pinv(slopes[:W, -W:])
            by_others = slopes[W:N, W:N] - held @ slopes[:W, W:N]
            rates, settles = self.rates(states, duty)[W:N], self.settles[W:N]
            by_others = by_others[np.ix_(settles, settles)]
            states[W:N][settles] -= np.linalg.lstsq(by_others, rates[settles], rcond=1e-9)[0]
        states[N:] = self._rubber.settled(self.torques(states) - self.torques(self.cold_states))
        return states

    def _compile(self) -> None:
        """The laws as functions of [x, V, D], and of [x, t] with the angle that each wire sees."""
        N, W, remembers = self.num_states, self.num_wires, self._rubber.remembers
        heat, torque = [], []
        every_state = np.arange(N)
        for group in self._groups:
            wires = np.arange(W)[group.wires]
            states = np.array([every_state[column] for column in group.states])
            fields, numbers, key = _numbers_of(group.law)
            key += (remembers,)
            if key not in _COMPILED:
                _COMPILED[key] = _compiled(group.law, fields, remembers)
                if len(_COMPILED) > _MOST_COMPILED:
                    del _COMPILED[next(iter(_COMPILED))]
            ambient = np.full((1, len(wires)), float(self._ambient))
            constants = np.concatenate([ambient, numbers.reshape(-1, len(wires))])
            by_torque = self._rubber.bend_by_torque[None, wires]
            of_heat, of_torque = _COMPILED[key]
            rows = [states, N + wires[None]]
            rows += [N + W + wires[None]] if remembers else []
            columns = np.concatenate([states, N + wires[None], N + W + wires[None]])
            heat.append(
                Part(of_heat, columns, np.concatenate(rows), np.concatenate([constants, by_torque]))
            )
            torque.append(
                Part(of_torque, np.concatenate([states, N + wires[None]]), wires[None], constants)
            )
        self._heat = SideBySide(heat, N + W + (W if remembers else 0), N + 2 * W)
        self._torque = SideBySide(torque, W, N + W)
        self.heat_pattern = self._heat.pattern[: N + W].copy()
        self.heat_curvature = self._heat.curvature.copy()
        if remembers:
            shifts = np.arange(self._first_shift, N)
            moving = self._rubber.pace != 0
            self.heat_pattern[shifts] = moving @ self._heat.pattern[N + W :]
            self.heat_pattern[shifts, shifts] = True
            self.heat_curvature[shifts] |= self.heat_pattern[shifts]
            self.heat_curvature[shifts, shifts] = False
            self.heat_curvature |= self.heat_curvature.T


def num_wire_states(parameters: LimbParameters) -> int:
    """N, the number of states of all wires' laws and of the rubber, without the readings."""
    own = sum(len(wire.law.states) for wire in parameters.wires)
    return own + num_rest_shifts(parameters)


_TIME_STEP = 1e-3  # s, of differences along the states' rates
_COMPILED: dict[tuple, tuple[CompiledFunction, CompiledFunction]] = {}
_MOST_COMPILED = 64


def _points(heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
    return np.concatenate([heat, duty], axis=-1)


def _torque_rate(law: WireLaw, x: Sequence[Any], rates: Sequence[Any], ambient: Any) -> Any:
    """How fast a law's torque changes, N·m/s, while its states x change with these rates.

    It is a central difference, which there is for all scalar types.
    """
    ahead, behind = (
        law.torque(
            [value + time * rate for value, rate in zip(x, rates, strict=True)], ambient, 0.0
        )
        for time in (_TIME_STEP, -_TIME_STEP)
    )
    return (ahead - behind) / (2 * _TIME_STEP)


def _numbers_of(law: WireLaw) -> tuple[list[str], np.ndarray, tuple]:
    """Names of a stacked law's fields that are numbers, their values, and what else it is."""
    values = {field.name: getattr(law, field.name) for field in dataclasses.fields(law)}  # type: ignore[arg-type]
    numbers = {
        name: value
        for name, value in values.items()
        if value.ndim == 1 and value.dtype.kind in "fi"
    }
    others = tuple((name, repr(value)) for name, value in values.items() if name not in numbers)
    return list(numbers), np.array(list(numbers.values()), float), (type(law), others)


def _compiled(
    law: WireLaw, fields: Sequence[str], remembers: bool
) -> tuple[CompiledFunction, CompiledFunction]:
    """A law's rates, reading rate and progress by [x, V, D], and its torque by [x, θ].

    Constants are the ambient temperature, the law's fields and, for the former, the bend by
    torque.
    """
    names = [*(f"x{number}" for number in range(len(law.states))), "V", "D", "theta", "T0"]
    symbols = {name: Variable(name) for name in [*names, *fields, "bend_by_torque"]}
    *x, V, D, theta, T0 = (np.array([Expression(symbols[name])]) for name in names)
    of_symbols = copy.copy(law)
    for name in fields:
        setattr(of_symbols, name, np.array([Expression(symbols[name])]))
    with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
        rates = list(of_symbols.rates(x, D, T0))
        values = [*rates, of_symbols.reading_rate(V, x)]
        if remembers:
            bend = symbols["bend_by_torque"] * _torque_rate(of_symbols, x, rates, T0)
            values.append(ramp(bend))
        torque = of_symbols.torque(x, T0, theta)
    states = [symbols[name] for name in names[: len(x)]]
    constants = [symbols["T0"], *(symbols[name] for name in fields)]
    return (
        CompiledFunction(
            [np.ravel(value)[0] for value in values],
            [*states, symbols["V"], symbols["D"]],
            [*constants, symbols["bend_by_torque"]],
        ),
        CompiledFunction([np.ravel(torque)[0]], [*states, symbols["theta"]], constants),
    )


def _as_slice(indices: list[int]) -> slice | np.ndarray:
    """Indices as a slice, which is read without a copy, if they are in a row."""
    first = indices[0]
    in_a_row = indices == list(range(first, first + len(indices)))
    return slice(first, first + len(indices)) if in_a_row else np.array(indices)


def _stacked(laws: list[WireLaw]) -> WireLaw:
    """A law whose fields are those of several laws of its class, as arrays."""
    together = copy.copy(laws[0])
    for field in dataclasses.fields(together):  # type: ignore[arg-type]
        setattr(together, field.name, np.array([getattr(law, field.name) for law in laws]))
    return together

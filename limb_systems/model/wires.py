"""All wires of a limb at once: their laws, element by element over any number of points."""

import copy
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.symbolic import (
    DecomposeAffineExpressions,
    Expression,
    Variable,
)

from limb_systems.model.derivatives import gradients, hessians
from limb_systems.model.parameters import LimbParameters
from limb_systems.model.rubber import REST_SCALE, Rubber, num_rest_shifts
from limb_systems.model.wire_law import TEMPERATURE_SCALE, WireLaw, within


@dataclasses.dataclass(frozen=True)
class _Alike:
    """Wires with laws of one class.

    - ``law``: its fields are arrays with an element for each wire.
    - ``wires``: indices of the wires among all wires.
    - ``states``: for each of the law's states, which they are among all states.
    """

    law: WireLaw
    wires: slice | np.ndarray
    states: list[slice | np.ndarray]

    def slots(self, num_states: int, num_wires: int) -> list[slice | np.ndarray]:
        """Where their states, reading and duty are in [x, V, D]."""
        return [
            *self.states,
            _shifted(self.wires, num_states),
            _shifted(self.wires, num_states + num_wires),
        ]


class Wires:
    """The W wires of a limb in its rubber, with N states in all.

    The states are the wire temperatures T (W) in the order of the wires, then
    the other states of their laws: the second state of all wires, the third,
    and so on. Those of `Rubber` are the last, if its rest angle has a memory.
    Arrays have the states, the wires or the joints along their last
    axis and any number of points before it.

    - ``num_wires``, ``num_states``: W and N.
    - ``state_names``: such as ``S_left``, N.
    - ``heat_scales``: typical changes of the states and of the readings (N + W,).
    - ``cold_states``: of wires that were never heated (N,).
    - ``settles``: which states are no memory (N,), true or false.
    - ``directions``: of the wires' torque on the joints (n, W), zero for
      joints of other segments, else e2 / |(e2, e3)|.
    - ``rates_are_affine``: in states, readings and duty.
    - ``torque_is_affine``: the force, in the states, and no function of the angle.
    - ``torque_needs_angle``: whether any force depends on the joint's angle.
    - ``heat_pattern``: which of `heat_rates` depend on which of [x, V, D],
      (N + W, N + 2W), true or false.
    - ``heat_curvature``, ``torque_curvature``: which pairs of [x, V, D], and of
      the states, may have second derivatives in `heat_rates` and in `forces`,
      (N + 2W, N + 2W) and (N, N), true or false.

    Args:
        parameters: of the limb.
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
        self._rubber = rubber = Rubber(parameters)
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
        self.directions = np.zeros((parameters.num_joints, self.num_wires))
        for joints, wires_of, segment in zip(
            parameters.joint_slices, parameters.wire_slices, parameters.segments, strict=True
        ):
            self.directions[joints, wires_of] = [wire.direction for wire in segment.wires]
        # Symbols take longer than all else here, and a plan makes many `Wires` of the same laws.
        key = (self._ambient, rubber.key, *((type(law), *vars(law).values()) for law in laws))
        if key not in _FORMS:
            _FORMS[key] = self._form()
            if len(_FORMS) > _MOST_FORMS:
                del _FORMS[next(iter(_FORMS))]
        form = _FORMS[key]
        self.rates_are_affine, self.heat_pattern = form.rates_are_affine, form.heat_pattern
        self._laws_need_angle = form.torque_needs_angle
        self.torque_is_affine = form.torque_is_affine and not rubber.stiffens
        self.torque_needs_angle = form.torque_needs_angle or rubber.stiffens
        self.heat_curvature, self.torque_curvature = form.heat_curvature, form.torque_curvature
        zero, off = np.zeros(self.num_states + self.num_wires), np.zeros(self.num_wires)
        if self.rates_are_affine:
            self._heat_slopes = self._heat_jacobian(zero, off)
        if self.torque_is_affine:
            straight = np.zeros(len(self.directions))
            self._force_slopes, _ = self._force_derivatives(zero[: self.num_states], straight)

    def rates(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """ẋ (..., N) of the states (..., N) under the duty (..., W), per second."""
        result = np.empty(states.shape, np.result_type(states, duty))
        progress = np.empty((*states.shape[:-1], self.num_wires), result.dtype)
        for group in self._groups:
            x = [states[..., column] for column in group.states]
            rates = group.law.rates(x, duty[..., group.wires], self._ambient)
            for column, rate in zip(group.states, rates, strict=True):
                result[..., column] = rate
            if self._rubber.remembers:
                progress[..., group.wires] = self._progress(group, x, rates)
        if self._rubber.remembers:
            shifts = slice(self._first_shift, None)
            result[..., shifts] = self._rubber.rates(states[..., shifts], progress)
        return result

    def within(self, states: np.ndarray) -> np.ndarray:
        """States (..., N) kept in the ranges of the laws' ``memory``, which steps may leave."""
        return within(states, *self._ranges)

    def _progress(self, group: _Alike, x: Sequence[Any], rates: Sequence[Any]) -> Any:
        """`Rubber.progress` of a group's wires, whose states x change with these rates.

        The torque's rate is a central difference, which there is for all scalar types.
        """
        ahead, behind = (
            group.law.torque(
                [value + time * rate for value, rate in zip(x, rates, strict=True)],
                self._ambient,
                0.0,
            )
            for time in (_TIME_STEP, -_TIME_STEP)
        )
        return self._rubber.progress((ahead - behind) / (2 * _TIME_STEP), group.wires)

    def _group_rates(self, group: _Alike, arguments: list) -> list:
        """Rates of a group's states and readings, and what `Rubber` remembers of them if it does.

        Args:
            arguments: the states, the reading and the duty of these wires.
        """
        *x, V, D = arguments
        rates = group.law.rates(x, D, self._ambient)
        progress = [self._progress(group, x, rates)] if self._rubber.remembers else []
        return [*rates, group.law.reading_rate(V, x), *progress]

    def torques(self, states: np.ndarray, angles: np.ndarray | None = None) -> np.ndarray:
        """Torque of each wire (..., W), N·m, as if it ran at +E2.

        With joint angles (..., n) in rad: on each joint, (..., n, W).
        """
        theta: np.ndarray | float = 0.0
        if angles is not None:
            states, theta = states[..., None, :], angles[..., :, None]
        shape = np.broadcast_shapes(states.shape[:-1], np.shape(theta)[:-1])
        kind = np.result_type(states, theta)
        result = np.empty((*shape, self.num_wires), kind)
        for group in self._groups:
            x = [states[..., column] for column in group.states]
            result[..., group.wires] = group.law.torque(x, self._ambient, theta)
        return result

    def forces(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Generalized force f (..., n) on the joints at the angles (..., n), N·m; eqn (4).

        That of `Rubber` is part of it.
        """
        if self._laws_need_angle:
            force = (self.torques(states, angles) * self.directions).sum(axis=-1)
        else:
            force = self.torques(states) @ self.directions.T
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
        return self._heat_jacobian(heat, duty)

    def _heat_jacobian(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        num_heat = self.num_states + self.num_wires
        shifts = slice(self._first_shift, self.num_states)
        kind = np.result_type(heat, duty)
        result = np.zeros((*heat.shape[:-1], num_heat, num_heat + self.num_wires), kind)
        for group in self._groups:
            slots = group.slots(self.num_states, self.num_wires)
            point = np.concatenate([heat, duty], axis=-1)
            scales = np.array([*group.law.states.values(), TEMPERATURE_SCALE, 1.0])
            arguments = [point[..., slot] for slot in slots]
            outputs = functools.partial(self._group_rates, group)
            partials = gradients(outputs, arguments, scales)
            for row, by in zip(slots[:-1], partials, strict=False):
                for column, values in zip(slots, by, strict=True):
                    result[..., _indices(row), _indices(column)] = values
            if self._rubber.remembers:
                by_shift, by_progress = self._rubber.rate_derivatives(
                    heat[..., shifts], outputs(arguments)[-1], group.wires
                )
                result[..., shifts, shifts] += by_shift
                for column, values in zip(slots, partials[-1], strict=True):
                    result[..., shifts, _indices(column)] = by_progress * values[..., None, :]
        return result

    def force_derivatives(
        self, states: np.ndarray, angles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Derivatives of `forces` by states (..., n, N), and of each by its joint's angle (..., n).

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
        theta = angles[..., :, None] if self._laws_need_angle else np.zeros(1)
        points = states[..., None, :]
        kind = np.result_type(states, theta)
        shape = np.broadcast_shapes(points.shape[:-1], theta.shape[:-1])[:-1]
        num_joints = len(self.directions)
        by_states = np.zeros((*shape, num_joints, self.num_states), kind)
        by_angle = np.zeros((*shape, num_joints), kind) if self.torque_needs_angle else None
        for group in self._groups:
            scales = np.array([*group.law.states.values(), 1.0])

            def outputs(arguments: list, law: WireLaw = group.law) -> list:
                *x, angle = arguments
                return [law.torque(x, self._ambient, angle)]

            arguments = [points[..., column] for column in group.states]
            (partials,) = gradients(outputs, [*arguments, theta], scales)
            directions = self.directions[:, group.wires]
            for column, by in zip(group.states, partials[:-1], strict=True):
                by_states[..., column] += directions * by
            if self._laws_need_angle:
                by_angle += (directions * partials[-1]).sum(axis=-1)
        by_states[..., self._first_shift :] = self._rubber.force_by_shift
        if self._rubber.stiffens:
            by_angle = by_angle + self._rubber.force_by_angle(angles)
        return by_states, by_angle

    def heat_hessian(self, heat: np.ndarray, duty: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · `heat_rates` by [x, V, D], (..., N + 2W, N + 2W).

        Args:
            heat, duty: as for `heat_rates`.
            weights: (..., N + W).
        """
        point = np.concatenate([heat, duty], axis=-1)
        result = np.zeros((*point.shape, point.shape[-1]))
        shifts = slice(self._first_shift, self.num_states)
        for group in self._groups:
            slots = group.slots(self.num_states, self.num_wires)
            arguments = [point[..., slot] for slot in slots]
            scales = np.array([*group.law.states.values(), TEMPERATURE_SCALE, 1.0])
            shares = [weights[..., slot] for slot in slots[:-1]]
            if self._rubber.remembers:
                share, share_by_shift = self._rubber.rate_shares(
                    heat[..., shifts], weights[..., shifts], group.wires
                )
                shares.append(share)

            def weighted(
                arguments: list, group: _Alike = group, shares: list = shares
            ) -> list[np.ndarray]:
                rates = self._group_rates(group, arguments)
                return [sum(share * rate for share, rate in zip(shares, rates, strict=True))]

            (second,) = hessians(weighted, arguments, scales)
            _add_blocks(result, slots, second)
            if self._rubber.remembers:
                outputs = functools.partial(self._group_rates, group)
                partials = gradients(outputs, arguments, scales)
                for column, values in zip(slots, partials[-1], strict=True):
                    mixed = share_by_shift * values[..., None, :]
                    result[..., shifts, _indices(column)] += mixed
                    result[..., _indices(column), shifts] += mixed.swapaxes(-1, -2)
        return result

    def force_hessian(
        self, states: np.ndarray, angles: np.ndarray, weights: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of weights · `forces` by the states (..., N, N), at fixed angles.

        Args:
            states, angles: as for `forces`.
            weights: (..., n).
        """
        result = np.zeros((*states.shape, self.num_states))
        theta: np.ndarray | float = 0.0
        if self._laws_need_angle:
            points, theta = states[..., None, :], angles[..., :, None]
            shares = weights[..., :, None] * self.directions
        else:
            points, shares = states, weights @ self.directions
        for group in self._groups:

            def weighted(
                x: list, law: WireLaw = group.law, share: np.ndarray = shares[..., group.wires]
            ) -> list[np.ndarray]:
                return [share * law.torque(x, self._ambient, theta)]

            arguments = [points[..., column] for column in group.states]
            scales = np.array(list(group.law.states.values()))
            (second,) = hessians(weighted, arguments, scales)
            if self._laws_need_angle:
                second = second.sum(axis=-2)
            _add_blocks(result, group.states, second)
        return result

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

    def at_constant_duty(
        self, states: np.ndarray, duty: np.ndarray, times: np.ndarray
    ) -> np.ndarray:
        """The states (K, N) at times (K,), s, under constant duty (W,), from states (N,) at time 0.

        By the classical Runge-Kutta method, in steps a tenth of the fastest time constant of
        cold wires.
        """
        fastest = np.abs(np.linalg.eigvals(self.affine_rates()[0])).max()
        now, courses = 0.0, []
        for time in times:
            num_steps = int(np.ceil((time - now) * max(10 * fastest, 1 / _LONGEST_STEP)))
            h = (time - now) / max(1, num_steps)
            for _ in range(num_steps):
                k1 = self.rates(states, duty)
                k2 = self.rates(states + h / 2 * k1, duty)
                k3 = self.rates(states + h / 2 * k2, duty)
                k4 = self.rates(states + h * k3, duty)
                states = self.within(states + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
            now = time
            courses.append(states)
        return np.array(courses)

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

    def _form(self) -> "_Form":
        """Finds out which formulas are affine, and what depends on what."""
        num_heat = self.num_states + self.num_wires
        heat, duty = _variables("y", num_heat), _variables("D", self.num_wires)
        angle = _variables("theta", 1)  # of any joint
        with np.errstate(invalid="ignore"):  # Expressions raise the flag, but no error
            rates = _expressions(self.heat_rates(heat, duty))
            torques = _expressions(self.torques(heat[: self.num_states], angle))
        depends = [_names(rate) for rate in rates]
        needs_angle = any("theta0" in _names(torque) for torque in torques)
        return _Form(
            rates_are_affine=_is_affine(rates, np.concatenate([heat, duty])),
            torque_is_affine=not needs_angle and _is_affine(torques, heat[: self.num_states]),
            torque_needs_angle=needs_angle,
            heat_pattern=np.array(
                [[str(v) in needed for v in (*heat, *duty)] for needed in depends]
            ),
            heat_curvature=_curvature(rates, np.concatenate([heat, duty])),
            torque_curvature=_curvature(torques, heat[: self.num_states]),
        )


@dataclasses.dataclass(frozen=True)
class _Form:
    """Which of a limb's laws are linear, and what depends on what; see `Wires`."""

    rates_are_affine: bool
    torque_is_affine: bool
    torque_needs_angle: bool
    heat_pattern: np.ndarray
    heat_curvature: np.ndarray
    torque_curvature: np.ndarray


def num_wire_states(parameters: LimbParameters) -> int:
    """N, the number of states of all wires' laws and of the rubber, without the readings."""
    own = sum(len(wire.law.states) for wire in parameters.wires)
    return own + num_rest_shifts(parameters)


_TIME_STEP = 1e-3  # s, of differences along the states' rates
_LONGEST_STEP = 0.5  # s, of integrations; warm wires may have states that are faster than cold ones
_FORMS: dict[tuple, "_Form"] = {}
_MOST_FORMS = 64


def _as_slice(indices: list[int]) -> slice | np.ndarray:
    """Indices as a slice, which is read without a copy, if they are in a row."""
    first = indices[0]
    in_a_row = indices == list(range(first, first + len(indices)))
    return slice(first, first + len(indices)) if in_a_row else np.array(indices)


def _shifted(indices: slice | np.ndarray, by: int) -> slice | np.ndarray:
    if isinstance(indices, slice):
        return slice(indices.start + by, indices.stop + by)
    return indices + by


def _indices(indices: slice | np.ndarray) -> np.ndarray:
    if isinstance(indices, slice):
        return np.arange(indices.start, indices.stop)
    return indices


def _stacked(laws: list[WireLaw]) -> WireLaw:
    """A law whose fields are those of several laws of its class, as arrays."""
    together = copy.copy(laws[0])
    for field in dataclasses.fields(together):  # type: ignore[arg-type]
        setattr(together, field.name, np.array([getattr(law, field.name) for law in laws]))
    return together


def _variables(name: str, size: int) -> np.ndarray:
    return np.array([Expression(Variable(f"{name}{index}")) for index in range(size)])


def _expressions(values: np.ndarray) -> list[Expression]:
    """All of an array, some of which may be plain numbers yet."""
    return [value if isinstance(value, Expression) else Expression(value) for value in values.flat]


def _names(expression: Expression) -> set[str]:
    return {variable.get_name() for variable in expression.GetVariables()}


def _add_blocks(result: np.ndarray, slots: list, blocks: np.ndarray) -> None:
    """Adds second derivatives (P, P, ...) by a law's variables to those by all (..., V, V)."""
    for row, by in zip(slots, blocks, strict=True):
        for column, values in zip(slots, by, strict=True):
            result[..., _indices(row), _indices(column)] += values


def _curvature(expressions: list[Expression], variables: np.ndarray) -> np.ndarray:
    """Which pairs of V variables are together in an expression that is not affine (V, V)."""
    pairs = np.zeros((len(variables), len(variables)), bool)
    for expression in expressions:
        if not _is_affine([expression], variables):
            depends = [str(variable) in _names(expression) for variable in variables]
            pairs |= np.outer(depends, depends)
    return pairs


def _is_affine(expressions: list[Expression], variables: np.ndarray) -> bool:
    symbols = [next(iter(variable.GetVariables())) for variable in variables]
    try:
        DecomposeAffineExpressions(expressions, symbols)
    except RuntimeError:
        return False
    return True

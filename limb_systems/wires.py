"""All wires of a limb in their rubber: the heat (6)-(7) and the forces (4), stated in symbols."""

from typing import Any

import casadi as ca
import numpy as np

from limb_systems.errors import LimbError
from limb_systems.law_functions import check_symbols
from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.limb_parameters import LimbParameters
from limb_systems.rubber import REST_SCALE, NonlinearRubber
from limb_systems.smooth_function import SmoothFunction, check_smooth
from limb_systems.wire_laws.wire_law import TEMPERATURE_SCALE, duty_for_rate, runge_kutta

MAX_SETTLING_STEPS = 20  # of Newton's method
SETTLING_TOLERANCE = 1e-10  # of a state, in its unit
LONGEST_STEP = 0.1  # s, of the integration of cold wires


class Wires:
    """The W wires of a limb in its rubber, with N states in all.

    The states are the wire temperatures T (W) in the order of the wires, then
    the other states of their laws: the second state of all wires, the third,
    and so on. Those of `NonlinearRubber` are the last, if its rest angle has a memory.
    Arrays have the states, the wires or the joints along their last
    axis and any number of points before it.

    - ``num_wires``, ``num_states``: W and N.
    - ``ambient_temperature``: T0, °C.
    - ``state_names``: such as ``S_left``, N.
    - ``heat_scales``: typical changes of the states and of the readings (N + W,).
    - ``cold_states``: states of wires that were never heated (N,).
    - ``settles``: true where a state is no memory (N,).
    - ``levers``: B, direction of the wires' torque on the joints (n, W), from `LimbMechanics`.
    - ``rates_are_affine``: whether heat rates are affine in states, readings and duty.
    - ``torque_is_affine``: whether forces are affine in the states, and no function of the angle.
    - ``are_linear``: whether both are true.
    - ``torque_needs_angle``: whether any force depends on the angle, of a wire or of the rubber.
    - ``heat``: [ẋ, V̇] (N + W,), per second, of [x, V, D], as a `SmoothFunction`: (6), (7) and the
      memory of the rubber. ``symbolic_heat`` is the same as a CasADi function of x, V and D.
    - ``force``: generalized force f (n,) on the joints, N·m, of [x, θ], as a `SmoothFunction`: (4)
      and nonlinear rubber. ``symbolic_force`` is the same as a CasADi function of x and θ.

    Args:
        parameters: description of the limb.
        mechanics: its joints.
    """

    def __init__(self, parameters: LimbParameters, mechanics: LimbMechanics):
        laws = [wire.law for wire in parameters.wires]
        T0 = parameters.ambient_temperature
        self._laws = laws
        self.num_wires = len(laws)
        self.ambient_temperature = T0
        self.levers = mechanics.levers
        self._links = mechanics.layout.link_of_joint
        # Number the states: the first of all wires, the second of all wires, and so on.
        self._columns: list[list[int]] = [[] for _ in laws]
        names: list[str] = []
        scales: list[float] = []
        cold: list[float] = []
        ranges: list[tuple[float, float]] = []
        settles: list[bool] = []
        for number in range(max(len(law.states) for law in laws)):
            for law, name, columns in zip(laws, parameters.wire_names, self._columns, strict=True):
                if number < len(law.states):
                    state = list(law.states)[number]
                    columns.append(len(names))
                    names.append(f"{state}_{name}")
                    scales.append(law.states[state])
                    cold.append(law.cold_states(T0)[number])
                    ranges.append(law.memory.get(state, (-np.inf, np.inf)))
                    settles.append(state not in law.memory)
        # Add the states of the rubber.
        self._rubber = NonlinearRubber(parameters, mechanics)
        self._first_shift = len(names)
        for name in self._rubber.state_names:
            names.append(name)
            scales.append(REST_SCALE)
            cold.append(0.0)
            ranges.append((-np.inf, np.inf))
            settles.append(False)
        self.num_states = len(names)
        self.state_names = names
        self.heat_scales = np.array(scales + [TEMPERATURE_SCALE] * self.num_wires)
        self.cold_states = np.array(cold, float)
        self._ranges = np.array(ranges).T
        self.settles = np.array(settles)
        # State heat and forces in symbols.
        x = ca.SX.sym("x", self.num_states)
        V = ca.SX.sym("V", self.num_wires)
        D = ca.SX.sym("D", self.num_wires)
        q = ca.SX.sym("q", mechanics.layout.num_joints)
        try:
            rates, reading_rates = self._state_heat(x, V, D)
            force = self._state_force(x, q)
        except LimbError:
            raise
        except Exception as error:  # of any kind: a lab's law may do anything with symbols
            kinds = ", ".join(dict.fromkeys(type(law).__name__ for law in laws))
            reason = str(error).strip().rstrip(".")
            raise LimbError(
                f"The wires' law ({kinds}) takes no symbols: {reason}. Write it with arithmetic "
                "and smooth functions, such as tanh, and without branches."
            ) from error
        heat_rates = ca.vertcat(rates, reading_rates)
        self.symbolic_heat = ca.Function("heat", [x, V, D], [heat_rates])
        self.symbolic_force = ca.Function("force", [x, q], [force])
        check_smooth(self.symbolic_heat)
        check_smooth(self.symbolic_force)
        for law in laws:
            check_symbols(law)
        self.heat = SmoothFunction(heat_rates, ca.vertcat(x, V, D))
        self.force = SmoothFunction(force, ca.vertcat(x, q))
        self._rates = SmoothFunction(rates, ca.vertcat(x, D))
        self._reading_rates = SmoothFunction(reading_rates, ca.vertcat(V, x))
        self._runge_kutta_step = self._state_runge_kutta_step(x, D, rates)
        # Find out what is linear.
        self.rates_are_affine = ca.is_linear(heat_rates, ca.vertcat(x, V, D))
        self.torque_needs_angle = ca.depends_on(force, q)
        self.torque_is_affine = not self.torque_needs_angle and ca.is_linear(force, x)
        self.are_linear = self.rates_are_affine and self.torque_is_affine

    def _state_heat(self, x: ca.SX, V: ca.SX, D: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return ẋ (N,) by (6) and the memory of the rubber, and V̇ (W,) by (7)."""
        T0 = self.ambient_temperature
        rates = ca.SX.zeros(self.num_states)
        torque_rates = []
        reading_rates = []
        for wire, (law, columns) in enumerate(zip(self._laws, self._columns, strict=True)):
            # Evaluate the law of each wire for its own states.
            wire_states = ca.vertsplit(x[columns])
            wire_rates = ca.vertcat(*law.rates(wire_states, D[wire], T0))
            rates[columns] = wire_rates
            reading_rates.append(law.reading_rate(V[wire], wire_states))
            torque = ca.SX(law.torque(wire_states, T0, 0.0))
            torque_rates.append(ca.jtimes(torque, x[columns], wire_rates))
        if self._rubber.remembers:
            shifts = slice(self._first_shift, None)
            rates[shifts] = self._rubber.rates(x[shifts], ca.vertcat(*torque_rates))
        return rates, ca.vertcat(*reading_rates)

    def _state_runge_kutta_step(self, x: ca.SX, D: ca.SX, rates: ca.SX) -> SmoothFunction:
        """Return x after a step (N,) as a function of [x, D0, D1, D2, h].

        D0, D1 and D2 are the duty at the beginning, in the middle and at the end of the step h, s.
        """
        rates_function = ca.Function("rates", [x, D], [rates])
        levels = [ca.SX.sym("D", D.numel()) for _ in range(3)]
        step = ca.SX.sym("h")
        after = self.clamp_states(runge_kutta(rates_function, x, levels, step))
        return SmoothFunction(after, ca.vertcat(x, *levels, step))

    def _state_force(self, x: ca.SX, q: ca.SX) -> ca.SX:
        """Return f (n,), N·m, where each link turns towards a wire by Σ B_j θ_j of its joints."""
        T0 = self.ambient_temperature
        force = self._rubber.forces(x[self._first_shift :], q)
        for link in range(self._links[-1] + 1):
            joints = np.flatnonzero(self._links == link).tolist()
            for wire, (law, columns) in enumerate(zip(self._laws, self._columns, strict=True)):
                levers = ca.DM(self.levers[joints, wire])
                if not levers.is_zero():
                    wire_states = ca.vertsplit(x[columns])
                    force[joints] += levers * law.torque(wire_states, T0, ca.dot(levers, q[joints]))
        return force

    def equal_wires(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the groups of wires that have equal laws and are heated by no other wire.

        A memory of the rubber depends on all wires, which are then one group of one.

        Returns:
            For each group of G, the indices of the states (G, ...) and of the wires (G, ...).
        """
        if self._rubber.remembers:
            return [(np.arange(self.num_states)[None], np.arange(self.num_wires)[None])]
        groups: dict[tuple[type, str], list[int]] = {}
        for wire, law in enumerate(self._laws):
            groups.setdefault((type(law), repr(law)), []).append(wire)
        result = []
        for group in groups.values():
            columns = np.array([self._columns[wire] for wire in group])
            result.append((columns, np.array(group)[:, None]))
        return result

    def rates(self, states: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return ẋ (..., N) of the states (..., N) under the duty (..., W), per second."""
        return self._rates.values(_joined(states, duty))

    def signals(self, states: np.ndarray) -> dict[str, Any]:
        """Return the wires' states x (N, K) as signals of a `Trajectory` or a `Gait`."""
        temperature, others = np.split(states, [self.num_wires])
        return {
            "wire_temperature": temperature,
            "other_wire_state": others if len(others) else None,
        }

    def holding_duty(self, states: np.ndarray) -> np.ndarray:
        """Return D (W,) under which wires of the states (N,) stay at their temperatures.

        If a law's rates are not affine in the duty, D is a first guess.
        """
        W = self.num_wires
        rates_off = self.rates(states, np.zeros(W))[:W]
        rates_on = self.rates(states, np.ones(W))[:W]
        return duty_for_rate(0.0, rates_off, rates_on)

    def clamp_states(self, states: ca.SX) -> ca.SX:
        """Return states (N,) in symbols, clamped to the ranges of the laws' ``memory``."""
        clamped = ca.SX(states)
        for state in np.flatnonzero(np.isfinite(self._ranges).any(axis=0)).tolist():
            low, high = self._ranges[:, state].tolist()
            value = ca.if_else(states[state] < low, low, states[state])
            clamped[state] = ca.if_else(high < states[state], high, value)
        return clamped

    def forces(self, states: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Return the force f (..., n), N·m, at the states x (..., N) and angles θ (..., n), rad."""
        return self.force.values(_joined(states, angles))

    def reading_rates(self, readings: np.ndarray, states: np.ndarray) -> np.ndarray:
        """Return V̇ (..., W) of the readings V (..., W), °C/s."""
        return self._reading_rates.values(_joined(readings, states))

    def heat_rates(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return `rates` and `reading_rates` of heat = [x, V] (..., N + W), side by side."""
        return self.heat.values(_joined(heat, duty))

    def affine_rates(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A (N, N), B (N, W) and c (N) of ẋ = A x + B D + c.

        They are the tangent at cold wires without duty. If the rates are affine, the tangent is
        the law itself. The memory of the rubber is left out: it begins to follow at rest, where a
        tangent says nothing.
        """
        N = self.num_states
        W = self.num_wires
        cold = np.concatenate([self.cold_states, self.cold_states[:W], np.zeros(W)])
        values, slopes = self.heat.first(cold)
        slopes[self._first_shift : N] = 0.0
        A = slopes[:N, :N]
        B = slopes[:N, N + W :]
        return A, B, values[:N] - A @ self.cold_states

    def integrate_states(
        self,
        states: np.ndarray,
        duty: np.ndarray,
        times: np.ndarray,
        longest_step: float = LONGEST_STEP,
    ) -> np.ndarray:
        """Return the states (K, N) at times (K,), s, under duty (K, W), which is linear between.

        By the classical Runge-Kutta method, in steps of half the fastest time constant of
        cold wires at most.

        Args:
            states: states at the first time (N,).
            longest_step: longest step of the integration, s, for states of warm wires
        """
        A, _, _ = self.affine_rates()
        fastest_rate = np.abs(np.linalg.eigvals(A)).max()
        stages = np.array([[0.0], [0.5], [1.0]])  # the beginning, middle and end of a step
        course = [states]
        for k, length in enumerate(np.diff(times)):
            num_steps = int(np.ceil(length * max(2 * fastest_rate, 1 / longest_step) - 1e-9))
            change = duty[k + 1] - duty[k]
            for step in range(num_steps):
                levels = duty[k] + (step + stages) / num_steps * change
                point = np.concatenate([states, levels.ravel(), [length / num_steps]])
                states = self._runge_kutta_step.values(point)
            course.append(states)
        return np.array(course)

    def settled_states(self, temperature: np.ndarray) -> np.ndarray:
        """Return the states (N,) of cold wires after heating to T (W,), °C, until they settled.

        The ``memory`` of a law is given by its `warm_states`. The memory of the rubber is as if all
        wires were heated at once.
        """
        W = self.num_wires
        wires_end = self._first_shift  # of the wires' states; the states of the rubber follow
        states = self._warm_states(temperature)
        duty = np.zeros(W)
        for _ in range(MAX_SETTLING_STEPS if wires_end > W else 0):
            # Find the duty that holds T.
            _, slopes = self.heat.first(np.concatenate([states, temperature, duty]))
            duty = duty - np.linalg.pinv(slopes[:W, -W:]) @ self.rates(states, duty)[:W]
            # Let the other states settle while the duty holds T.
            rates, slopes = self.heat.first(np.concatenate([states, temperature, duty]))
            by_duty = slopes[W:wires_end, -W:] @ np.linalg.pinv(slopes[:W, -W:])
            by_others = slopes[W:wires_end, W:wires_end] - by_duty @ slopes[:W, W:wires_end]
            settles = self.settles[W:wires_end]
            residual = rates[W:wires_end][settles]
            jacobian = by_others[np.ix_(settles, settles)]
            step = np.linalg.lstsq(jacobian, residual, rcond=1e-9)[0]
            states[W:wires_end][settles] -= step
            if np.abs(step).max(initial=0.0) < SETTLING_TOLERANCE:
                break
        return self._with_settled_rubber(states)

    def rested_states(self, temperature: np.ndarray) -> np.ndarray:
        """Return the states (N,) of wires without heat whose silicone has cooled to T (W,), °C.

        The silicone cools slowest; wires and thermocouples follow it.
        """
        states = self._warm_states(temperature)
        for law, columns, T in zip(self._laws, self._columns, temperature, strict=True):
            for column, state in zip(columns, law.states, strict=True):
                if law.is_temperature(state) and state not in law.memory:
                    states[column] = T
        return self._with_settled_rubber(states)

    def _warm_states(self, temperature: np.ndarray) -> np.ndarray:
        """Return the states (N,) by the laws' `warm_states`."""
        states = self.cold_states.copy()
        for law, columns, T in zip(self._laws, self._columns, temperature, strict=True):
            states[columns] = law.warm_states(T, self.ambient_temperature)
        return states

    def _with_settled_rubber(self, states: np.ndarray) -> np.ndarray:
        """Return the states (N,) with the memory of the rubber settled under the wires' torques."""
        T0 = self.ambient_temperature
        torques = np.zeros(self.num_wires)
        for wire, (law, columns) in enumerate(zip(self._laws, self._columns, strict=True)):
            warm_torque = law.torque(states[columns], T0, 0.0)
            torques[wire] = warm_torque - law.torque(law.cold_states(T0), T0, 0.0)
        states[self._first_shift :] = self._rubber.settled(torques)
        return states


def among_zeros(values: ca.SX, indices: np.ndarray, size: int) -> ca.SX:
    """Return values at some indices of a column (size,) that is zero elsewhere."""
    column = ca.SX.zeros(size)
    column[indices.tolist()] = values
    return column


def _joined(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return arrays (..., size) side by side, with equal points."""
    if left.shape[:-1] != right.shape[:-1]:
        shape = np.broadcast_shapes(left.shape[:-1], right.shape[:-1])
        left = np.broadcast_to(left, (*shape, left.shape[-1]))
        right = np.broadcast_to(right, (*shape, right.shape[-1]))
    return np.concatenate([left, right], axis=-1)

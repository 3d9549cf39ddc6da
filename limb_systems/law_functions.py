"""The step and the torque of a wire law at many points, with derivatives.

A law is stated for one wire. Symbols make its functions fast, but a law of a lab may branch on
numbers, which symbols pass without an error. So its functions with symbols are compared with the
law in numbers, and a law for which they differ is evaluated in numbers.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from limb_systems.errors import LimbError
from limb_systems.limb_parameters import LimbParameters
from limb_systems.smooth_function import SmoothFunction, build_once, check_smooth
from limb_systems.wire_laws.wire_law import WireLaw, runge_kutta

NUM_PROBES = 100  # points at which symbols are compared with numbers
PROBE_TOLERANCE = 1e-6  # relative
MAX_PROBE_TEMPERATURE = 200.0  # °C
MAX_PROBE_ROOM = 40.0  # °C
PROBE_RATIO = 3.0  # of the largest probed value of a field to its default
DIFFERENCE_STEP = 1e-6  # of finite differences, relative
MIN_DIFFERENCE_SIZE = 1e-2  # least size of a value, to which a step is relative


class NumericFunction:
    """A function of points (..., P) with values (..., Q), as `SmoothFunction`, in numbers alone.

    Its derivatives are finite differences.

    Args:
        of_point: function of P rows, numbers or arrays, that returns Q rows.
        is_elementwise: whether it takes arrays.
    """

    def __init__(self, of_point: Callable[[Any], Any], is_elementwise: bool):
        self._of_point = of_point
        self._is_elementwise = is_elementwise

    def values(self, points: np.ndarray) -> np.ndarray:
        """Return the values (..., Q)."""
        rows = np.moveaxis(points, -1, 0)
        values = self._evaluate(rows.reshape(len(rows), -1))
        return values.T.reshape(*points.shape[:-1], len(values))

    def first(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (..., Q), and their derivatives by the points (..., Q, P)."""
        values = self.values(points)
        slopes = np.empty((*values.shape, points.shape[-1]))
        for column in range(points.shape[-1]):
            moved = points.copy()
            size = np.maximum(np.abs(points[..., column]), MIN_DIFFERENCE_SIZE)
            moved[..., column] += DIFFERENCE_STEP * size
            step = (moved[..., column] - points[..., column])[..., None]
            slopes[..., column] = (self.values(moved) - values) / step
        return values, slopes

    def bound(self, points: np.ndarray, values: np.ndarray) -> Callable[[], None]:
        """Return a function that evaluates points (P, n) from an array into values (Q, n)."""

        def evaluate() -> None:
            values[...] = self._evaluate(points)

        return evaluate

    def _evaluate(self, points: np.ndarray) -> np.ndarray:
        """Return the values (Q, n) at points (P, n)."""
        if self._is_elementwise:
            return self._of_point(points)
        return np.stack([self._of_point(point) for point in points.T], axis=-1)


def check_affine(limb: LimbParameters) -> None:
    """Raise LimbError if the rates of a wire at half duty are not midway between off and on."""
    for wire in limb.wires:
        law = wire.law
        states = np.array(law.warm_states(60.0, 20.0), float)  # of 60 °C in a room of 20 °C
        duties = np.array([0.0, 0.5, 1.0])
        off, half, on = (np.array(law.rates(states, duty, 20.0)) for duty in duties)
        if not np.allclose(half, (off + on) / 2, rtol=1e-6):
            raise LimbError(
                f"The rates of {type(law).__name__} are not affine in the duty, as recording, "
                "feedback and walks take them to be. State them in a duty to which the heat is "
                "proportional, as in PWM, and convert it where your board sets it."
            )


def check_symbols(law: WireLaw) -> None:
    """Raise LimbError if a law gives other values with symbols than with numbers.

    It raises LimbError, too, if a field of the law has no default. The first limb of a class of
    laws is checked, and the first with other words or switches.
    """

    def all_values(law: WireLaw, heat: Any, T0: Any, last: Any, join: Callable) -> Any:
        *states, reading = [heat[row] for row in range(len(law.states) + 1)]
        rates = [*law.rates(states, last, T0), law.reading_rate(reading, states)]
        return join([*rates, law.torque(states, T0, last)])

    def build() -> SmoothFunction | NumericFunction:
        return _law_function(law, "rates and torque", all_values, len(law.states) + 2, (0.0, 1.0))

    # A word or a switch may choose other equations. Numbers are expected not to.
    switches = []
    for field in dataclasses.fields(law):  # type: ignore[arg-type]
        if field.default is field.default_factory is dataclasses.MISSING:
            raise LimbError(
                f"The field {field.name} of {type(law).__name__} has no default, from which fits "
                "and checks start; give it one."
            )
        if not isinstance(field.default, float):
            switches.append(getattr(law, field.name))
    if isinstance(build_once(("checked", type(law), repr(switches)), build), NumericFunction):
        raise LimbError(
            f"{type(law).__name__} gives other values with symbols than with numbers, as laws with "
            "branches (if, float) do. A limb needs a law that takes symbols: write it with "
            "arithmetic and smooth functions, such as tanh."
        )


def law_step(law: WireLaw, step: float) -> SmoothFunction | NumericFunction:
    """Return the function of `law_points` that gives the heat after a step of duty (X + 1)."""

    def heat_after(law: WireLaw, heat: Any, T0: Any, duty: Any, join: Callable) -> Any:
        def rates(heat: Any, duty: Any) -> Any:
            *states, reading = [heat[row] for row in range(len(law.states) + 1)]
            return join([*law.rates(states, duty, T0), law.reading_rate(reading, states)])

        return runge_kutta(rates, heat, (duty, duty, duty), step)

    return _law_function(law, f"step of {step} s", heat_after, len(law.states) + 1, (0.0, 1.0))


def law_torque(law: WireLaw) -> SmoothFunction | NumericFunction:
    """Return the function of `law_points` that gives the torque (1,) at an angle θ."""

    def torque(law: WireLaw, heat: Any, T0: Any, theta: Any, join: Callable) -> Any:
        states = [heat[row] for row in range(len(law.states))]
        return join([law.torque(states, T0, theta)])

    return _law_function(law, "torque", torque, 1, (-1.0, 1.0))


def law_points(
    law: WireLaw, heat: np.ndarray, T0: np.ndarray, last: np.ndarray | float
) -> np.ndarray:
    """Return the points (P, ...) of a law's functions: heat, T0, the law's N fields, and an input.

    Args:
        law: with fields that are arrays, which broadcast with T0.
        heat: the X states of a wire, and V (X + 1, ...).
        T0: °C (...).
        last: duty of `law_step` (...); θ of `law_torque` (...), rad.
    """
    fields = array_fields(law)
    points = np.empty((len(heat) + len(fields) + 2, *heat.shape[1:]))
    points[: len(heat)] = heat
    for row, values in enumerate([T0, *fields.values(), last], len(heat)):
        points[row] = values
    return points


def array_fields(law: WireLaw) -> dict[str, np.ndarray]:
    """Return the fields of a law that are arrays."""
    return {name: value for name, value in vars(law).items() if isinstance(value, np.ndarray)}


def with_fields(law_type: type[WireLaw], fields: Mapping[str, Any]) -> WireLaw:
    """Return a law of a class whose fields are arrays or symbols, for calculations only."""
    law = law_type()
    for name, values in fields.items():
        setattr(law, name, values)
    return law


def _law_function(
    law: WireLaw,
    kind: str,
    statement: Callable[..., Any],
    num_values: int,
    input_range: tuple[float, float],
) -> SmoothFunction | NumericFunction:
    """Return a function of the points of a law, see `law_points`.

    Args:
        law: law whose arrays give only their names to the function, and no values.
        kind: name of the function.
        statement: the function by law, heat, T0, input, and how its values are joined.
        num_values: number of its values.
        input_range: least and largest input.
    """
    names = list(array_fields(law))
    num_heat = len(law.states) + 1
    number_fields = {name: value for name, value in vars(law).items() if name not in names}

    def of_rows(rows: Any, join: Callable) -> Any:
        fields = {name: rows[row] for row, name in enumerate(names, num_heat + 1)}
        wire_law = with_fields(type(law), number_fields | fields)
        heat = rows[:num_heat]
        return statement(wire_law, heat, rows[num_heat], rows[num_heat + 1 + len(names)], join)

    def in_numbers(points: np.ndarray) -> np.ndarray:
        def join(values: Sequence[Any]) -> np.ndarray:
            rows = np.empty((len(values), *points.shape[1:]))
            for row, value in enumerate(values):
                rows[row] = value
            return rows

        try:
            return of_rows(points, join)
        except LimbError:
            raise
        except Exception as error:  # of any kind: a lab's law may do anything with its fields
            raise LimbError(
                f"The {kind} of {type(law).__name__} fails in numbers: {error}; correct the law."
            ) from error

    def build() -> SmoothFunction | NumericFunction:
        probes = _probe_points(law, names, input_range)
        expected = np.full((len(probes), num_values), np.nan)  # where the law fails
        for row, point in zip(expected, probes, strict=True):
            with contextlib.suppress(LimbError), np.errstate(all="ignore"):
                row[:] = in_numbers(point)
        # Use symbols if they agree with the numbers of one wire after the other.
        with contextlib.suppress(Exception):  # of any kind: a law may do anything with symbols
            point = ca.SX.sym("x", probes.shape[1])
            values = of_rows(point, lambda values: ca.vertcat(*values))
            check_smooth(ca.Function("law", [point], [values]))
            function = SmoothFunction(values, point)
            if _agree(function.values(probes), expected):
                return function
        # Use numbers, of all wires at once if that agrees.
        at_once = NumericFunction(in_numbers, True)
        with contextlib.suppress(LimbError), np.errstate(all="ignore"):
            if _agree(at_once.values(probes), expected):
                return at_once
        return NumericFunction(in_numbers, False)

    # Limbs with laws of one class share the function.
    return build_once((kind, type(law), tuple(names), repr(number_fields)), build)


def _agree(values: np.ndarray, expected: np.ndarray) -> bool:
    """Return whether values (n, Q) are as expected."""
    sizes = np.abs(np.where(np.isfinite(expected), expected, 0.0)).max(axis=0)
    is_near = np.isclose(values, expected, PROBE_TOLERANCE, 1e-9 * sizes, equal_nan=True)
    return bool(is_near.all())


def _probe_points(
    law: WireLaw, names: Sequence[str], input_range: tuple[float, float]
) -> np.ndarray:
    """Return random points (n, P) of a Latin hypercube over what recordings and fits may have."""
    default_law = type(law)()
    # States, V and T0.
    ranges = []
    for (state, scale), cold in zip(law.states.items(), default_law.cold_states(20.0), strict=True):
        low, high = law.memory.get(state, (-np.inf, np.inf))
        is_temperature = law.is_temperature(state)
        lowest, highest = (
            (0.0, MAX_PROBE_TEMPERATURE) if is_temperature else (cold - scale, cold + 3 * scale)
        )
        ranges.append((max(low, lowest), min(high, highest)))
    ranges += [(0.0, MAX_PROBE_TEMPERATURE), (0.0, MAX_PROBE_ROOM)]
    # Fields, about their defaults.
    metadata = {field.name: field.metadata for field in dataclasses.fields(law)}  # type: ignore[arg-type]
    for name in names:
        default = getattr(default_law, name)
        usual = sorted([default / PROBE_RATIO, default * PROBE_RATIO]) if default else [0.0, 0.1]
        allowed = metadata[name].get("range", (-np.inf, np.inf))  # a lab may not say it
        low, high = np.clip(usual, *allowed).tolist()
        ranges.append((low, high))
    ranges.append(input_range)
    # Each value has one point in each of as many parts of its range as there are points.
    random = np.random.default_rng(0)
    parts = random.permuted(np.tile(np.arange(NUM_PROBES), (len(ranges), 1)), axis=1)
    shares = (parts + random.random(parts.shape)) / NUM_PROBES
    low_values, high_values = np.transpose(ranges)
    return low_values + shares.T * (high_values - low_values)

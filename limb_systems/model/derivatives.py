"""Symbolic expressions as Python code with their first and second derivatives.

A law of a wire is a few dozen operations. They are taken from Drake's symbolic
expressions once for each law, and differentiated one after the other (forward, to the
second order); what is zero is left out, and what is used twice is calculated once.
The code runs on numpy's arrays, and on Python's numbers, where it takes
microseconds.
"""

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from types import CodeType
from typing import Any

import numpy as np
from pydrake.symbolic import Expression, ExpressionKind, Variable

from limb_systems.errors import LimbError

# What a function of one argument u and its value v has as derivatives; the second may use the
# first, f.
_FUNCTIONS = {
    ExpressionKind.Abs: ("abs({u})", "copysign(1.0, {u})", "0.0"),
    ExpressionKind.Acos: ("acos({u})", "-1.0 / sqrt(1.0 - {u} * {u})", "{u} * {f} * {f} * {f}"),
    ExpressionKind.Asin: ("asin({u})", "1.0 / sqrt(1.0 - {u} * {u})", "{u} * {f} * {f} * {f}"),
    ExpressionKind.Atan: ("atan({u})", "1.0 / (1.0 + {u} * {u})", "-2.0 * {u} * {f} * {f}"),
    ExpressionKind.Cos: ("cos({u})", "-sin({u})", "-{v}"),
    ExpressionKind.Cosh: ("cosh({u})", "sinh({u})", "{v}"),
    ExpressionKind.Exp: ("exp({u})", "{v}", "{v}"),
    ExpressionKind.Log: ("log({u})", "1.0 / {u}", "-{f} * {f}"),
    ExpressionKind.Sin: ("sin({u})", "cos({u})", "-{v}"),
    ExpressionKind.Sinh: ("sinh({u})", "cosh({u})", "{v}"),
    ExpressionKind.Sqrt: ("sqrt({u})", "0.5 / {v}", "-{f} * {f} / {v}"),
    ExpressionKind.Tan: ("tan({u})", "1.0 + {v} * {v}", "2.0 * {v} * {f}"),
    ExpressionKind.Tanh: ("tanh({u})", "1.0 - {v} * {v}", "-2.0 * {v} * {f}"),
}
_IN_NUMPY = {"acos": "arccos", "asin": "arcsin", "atan": "arctan"}
_NAMES = (
    *("acos", "asin", "atan", "copysign", "cos", "cosh", "exp", "log"),
    *("sin", "sinh", "sqrt", "tan", "tanh"),
)
_OF_ARRAYS = {"abs": np.abs} | {name: getattr(np, _IN_NUMPY.get(name, name)) for name in _NAMES}
_OF_NUMBERS = {"abs": abs} | {name: getattr(math, name) for name in _NAMES}

Jet = tuple[str, dict[int, str], dict[tuple[int, int], str]]


class CompiledFunction:
    """Q expressions of P variables and C constants, with derivatives by the variables.

    All its functions take and return sequences of numbers, or of arrays of floats that can
    be broadcast.

    - ``values(variables, constants)``: the values, Q.
    - ``first(variables, constants)``: the values (Q), then the derivatives in the order
      of ``first_places``.
    - ``second(variables, constants, weights)``: second derivatives of weights · values in the order
      of ``second_places``.
    - ``first_places``: index of value and of variable of each derivative that is not zero (F, 2).
    - ``second_places``: indices i >= j of the variables of each second derivative that is not
      zero (S, 2).

    Args:
        expressions: a sequence of Q expressions or numbers.
        variables, constants: their arguments.

    Raises:
        LimbError: if an expression is not smooth.
    """

    def __init__(
        self,
        expressions: Sequence[Expression | float],
        variables: Sequence[Variable],
        constants: Sequence[Variable],
    ):
        writer = _Writer(variables, constants)
        jets = [writer.jet(Expression(0.0) + expression) for expression in expressions]
        weights = [f"w{number}" for number in range(len(jets))]
        weighted: dict[tuple[int, int], str] = {}
        values = [value for value, _, _ in jets]
        self.first_places = np.array(
            [(number, variable) for number, (_, by, _) in enumerate(jets) for variable in by],
            int,
        ).reshape(-1, 2)
        first = [slope for _, by, _ in jets for slope in by.values()]
        self.values = writer.function(values)
        self.first = writer.function(values + first)
        for weight, (_, _, curved) in zip(weights, jets, strict=True):
            for place, value in curved.items():
                writer.add(weighted, place, writer.times(weight, value))
        self.second_places = np.array(list(weighted), int).reshape(-1, 2)
        self.second = writer.function(list(weighted.values()), weights)


class _Writer:
    """Lines of code, each of which names a value that no other one names."""

    def __init__(self, variables: Sequence[Variable], constants: Sequence[Variable]):
        self._arguments = [
            [f"{letter}{number}" for number in range(len(group))]
            for letter, group in (("x", variables), ("c", constants))
        ]
        names = [name for group in self._arguments for name in group]
        self._jets: dict[Any, Jet] = {
            symbol.get_id(): (name, {number: "1.0"} if number < len(variables) else {}, {})
            for number, (symbol, name) in enumerate(
                zip([*variables, *constants], names, strict=True)
            )
        }
        self._lines: dict[str, str] = {}  # names of what is calculated

    def jet(self, expression: Expression) -> Jet:
        """Names of an expression's value and of its derivatives that are not zero."""
        kind = expression.get_kind()
        if kind == ExpressionKind.Constant:
            return repr(expression.Evaluate()), {}, {}
        if kind == ExpressionKind.Var:
            (symbol,) = expression.GetVariables()
            return self._jets[symbol.get_id()]
        key = str(expression)
        if key not in self._jets:
            arguments = [self.jet(Expression(0.0) + part) for part in expression.Unapply()[1]]
            self._jets[key] = self._apply(kind, arguments)
        return self._jets[key]

    def _apply(self, kind: ExpressionKind, arguments: list[Jet]) -> Jet:
        if kind in (ExpressionKind.Add, ExpressionKind.Mul):
            combine = self._sum if kind == ExpressionKind.Add else self._product
            result = arguments[0]
            for other in arguments[1:]:
                result = combine(result, other)
            return result
        if kind == ExpressionKind.Div:
            return self._quotient(*arguments)
        if kind == ExpressionKind.Pow:
            return self._power(*arguments)
        if kind not in _FUNCTIONS:
            raise LimbError(
                f"A law of a wire uses {kind.name}, which is not smooth or has no derivative here; "
                "write it with powers, exp, log, tanh and the like."
            )
        return self._chain(arguments[0], *_FUNCTIONS[kind])

    def _sum(self, one: Jet, other: Jet) -> Jet:
        first, second = dict(one[1]), dict(one[2])
        for sums, parts in ((first, other[1]), (second, other[2])):
            for place, value in parts.items():
                self.add(sums, place, value)
        return self.plus(one[0], other[0]), first, second

    def _product(self, one: Jet, other: Jet) -> Jet:
        first: dict[int, str] = {}
        second: dict[tuple[int, int], str] = {}
        for (value, _, _), (_, by, curved) in ((one, other), (other, one)):
            for place, slope in by.items():
                self.add(first, place, self.times(value, slope))
            for pair, curvature in curved.items():
                self.add(second, pair, self.times(value, curvature))
        for i, by_i in one[1].items():
            for j, by_j in other[1].items():
                both = self.times(by_i, by_j)
                both = self.times("2.0", both) if i == j else both
                self.add(second, (max(i, j), min(i, j)), both)
        return self.times(one[0], other[0]), first, second

    def _quotient(self, one: Jet, other: Jet) -> Jet:
        if not other[1]:
            first = {place: self._over(slope, other[0]) for place, slope in one[1].items()}
            second = {pair: self._over(curved, other[0]) for pair, curved in one[2].items()}
            return self._over(one[0], other[0]), first, second
        return self._product(one, self._chain(other, "1.0 / {u}", "-{v} * {v}", "-2.0 * {v} * {f}"))

    def _power(self, base: Jet, exponent: Jet) -> Jet:
        if exponent[1]:  # u**w = exp(w log u)
            log = self._chain(base, *_FUNCTIONS[ExpressionKind.Log])
            return self._chain(self._product(exponent, log), *_FUNCTIONS[ExpressionKind.Exp])
        if exponent[0] == "2.0":
            return self._product(base, base)
        less, least = (self.plus(exponent[0], repr(-by)) for by in (1.0, 2.0))
        first = f"{exponent[0]} * {{u}} ** {less}"
        return self._chain(
            base, f"{{u}} ** {exponent[0]}", first, f"{exponent[0]} * {less} * {{u}} ** {least}"
        )

    def _chain(self, inner: Jet, value: str, by: str, curved: str) -> Jet:
        """Jet of a function of an inner one, by the code of the function and its derivatives."""
        u, slopes, curvatures = inner
        v = self.line(value.format(u=u))
        if not slopes:
            return v, {}, {}
        f = v if by == "{v}" else self.line(by.format(u=u, v=v))
        first = {place: self.times(f, slope) for place, slope in slopes.items()}
        second = {pair: self.times(f, curvature) for pair, curvature in curvatures.items()}
        if curved != "0.0":
            bent = v if curved == "{v}" else self.line(curved.format(u=u, v=v, f=f))
            for i, by_i in slopes.items():
                for j, by_j in slopes.items():
                    if i >= j:
                        self.add(second, (i, j), self.times(bent, self.times(by_i, by_j)))
        return v, first, second

    def add(self, sums: dict, place: Any, value: str) -> None:
        """Adds a value to that of a place."""
        sums[place] = self.plus(sums[place], value) if place in sums else value

    def plus(self, a: str, b: str) -> str:
        """Name of a + b."""
        if _is_number(a) and _is_number(b):
            return repr(float(a) + float(b))
        a, b = sorted((a, b))
        return b if a == "0.0" else self.line(f"{a} + {b}")

    def times(self, a: str, b: str) -> str:
        """Name of a b."""
        if _is_number(a) and _is_number(b):
            return repr(float(a) * float(b))
        a, b = sorted((a, b))
        return b if a == "1.0" else self.line(f"{a} * {b}")

    def _over(self, a: str, b: str) -> str:
        if _is_number(a) and _is_number(b):
            return repr(float(a) / float(b))
        return self.line(f"{a} / {b}")

    def line(self, text: str) -> str:
        """Name of what is calculated so."""
        return self._lines.setdefault(text, f"v{len(self._lines)}")

    def function(self, names: Sequence[str], weights: Sequence[str] = ()) -> Callable:
        """A function that returns what has these names."""
        used, needed = [], set(names)
        for text, name in reversed(self._lines.items()):
            if name in needed:
                fresh = set(_VALUE.findall(text)) - needed
                used.append((name, text, fresh))  # from which line on they are not needed
                needed |= fresh
        groups = [*self._arguments, list(weights)] if weights else self._arguments
        source = f"def function({', '.join('xcw'[: len(groups)])}):\n"
        for letter, group in zip("xcw", groups, strict=False):
            source += f"    {''.join(name + ', ' for name in group)} = {letter}\n" if group else ""
        # Names are used again, so that the memory of arrays is, while it is in the cache.
        places: dict[str, str] = {}
        free: list[str] = []
        for name, text, last in reversed(used):
            text = _VALUE.sub(lambda match: places[match[0]], text)
            free += [places[old] for old in last]
            places[name] = free.pop() if free else f"v{len(places)}"
            source += f"    {places[name]} = {text}\n"
        source += f"    return [{', '.join(places.get(name, name) for name in names)}]\n"
        return _in_both(compile(source, "<law of a wire>", "exec"))


_VALUE = re.compile(r"\bv\d+\b")


def _in_both(code: CodeType) -> Callable:
    """A function of a sequence of numbers or of arrays, by what its first argument begins with."""
    functions = []
    for names in (_OF_NUMBERS, _OF_ARRAYS):
        scope: dict[str, Any] = dict(names)
        exec(code, scope)
        functions.append(scope["function"])
    of_numbers, of_arrays = functions

    def function(variables, *others):
        if type(variables[0]) is float:
            try:
                return of_numbers(variables, *others)
            except (ArithmeticError, ValueError):
                variables = [np.float64(value) for value in variables]  # inf and NaN as of arrays
        return of_arrays(variables, *others)

    return function


def _is_number(name: str) -> bool:
    return name[0] not in "vxcw"


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """A function that is applied to E parts of a point.

    - ``variables``: indices of the function's variables in the point (P, E).
    - ``values``: indices of its values among all values (Q, E).
    - ``constants``: C numbers for each part (C, E).
    """

    function: CompiledFunction
    variables: np.ndarray
    values: np.ndarray
    constants: np.ndarray


class SideBySide:
    """Several functions of parts of points (..., P) as one function with values (..., Q).

    - ``pattern``: true where a value depends on a variable (Q, P).
    - ``curvature``: true where a pair of variables may have a second derivative (P, P).

    Args:
        parts: all functions; no two have a value in common.
        num_values, num_variables: Q and P.
    """

    def __init__(self, parts: Sequence[Part], num_values: int, num_variables: int):
        self._parts = parts
        # What one point takes, which is evaluated with Python's numbers.
        self._single = [
            (part.function, *(array[:, element].tolist() for array in arrays))
            for part in parts
            for arrays in [(part.variables, part.constants, part.values)]
            for element in range(arrays[0].shape[1])
        ]
        none = np.zeros((2, 0), int)
        self._first, self._second = (
            np.hstack([none, *(places(part) for part in parts)])
            for places in (self._first_places, self._second_places)
        )
        self.pattern = np.zeros((num_values, num_variables), bool)
        self.pattern[tuple(self._first)] = True
        self.curvature = np.zeros((num_variables, num_variables), bool)
        self.curvature[tuple(self._second)] = True
        self.curvature |= self.curvature.T

    @staticmethod
    def _first_places(part: Part) -> np.ndarray:
        value, variable = part.function.first_places.T
        return np.array([part.values[value].T.ravel(), part.variables[variable].T.ravel()])

    @staticmethod
    def _second_places(part: Part) -> np.ndarray:
        one, other = part.function.second_places.T
        return np.array([part.variables[one].T.ravel(), part.variables[other].T.ravel()])

    def values(self, points: np.ndarray) -> np.ndarray:
        """The values (..., Q)."""
        return self._evaluate("values", points, 0)[0]

    def first(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values (..., Q), and their derivatives (..., Q, P)."""
        values, slopes = self._evaluate("first", points, self._first.shape[1])
        result = np.zeros((*values.shape, points.shape[-1]))
        result[..., self._first[0], self._first[1]] = slopes
        return values, result

    def second(self, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives (..., P, P) of weights · values, for weights (..., Q)."""
        _, curvatures = self._evaluate("second", points, self._second.shape[1], weights)
        result = np.zeros((*points.shape, points.shape[-1]))
        for one, other in (self._second, self._second[::-1]):
            result[..., one, other] = curvatures
        return result

    def _evaluate(
        self, name: str, points: np.ndarray, size: int, weights: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Values (..., Q), without weights, and as many derivatives (..., size) in their order."""
        if points.ndim == 1:
            return self._evaluate_one(name, points, weights)
        Q = len(self.pattern)
        shape = points.shape[:-1]
        values, derivatives = np.zeros((Q, *shape)), np.empty((size, *shape))
        # Numpy is fast where the points are the last axis, in a row.
        to_front, to_back = (len(shape), *range(len(shape))), (*range(1, len(shape) + 1), 0)
        point, on, done = np.ascontiguousarray(points.transpose(to_front)), None, 0
        if weights is not None:
            on = np.ascontiguousarray(weights.transpose(to_front))
        for part in self._parts:
            count = part.variables.shape[1]
            constants = part.constants.reshape(*part.constants.shape, *[1] * len(shape))
            arguments = [[point[indices] for indices in part.variables], constants]
            if on is not None:
                arguments.append([on[places] for places in part.values])
            found = getattr(part.function, name)(*arguments)
            if weights is None:
                for places, value in zip(part.values, found, strict=False):
                    values[places] = value
                found = found[len(part.values) :]
            rows = derivatives[done : done + count * len(found)]
            for number, value in enumerate(found):
                rows[number :: len(found)] = value
            done += len(rows)
        return values.transpose(to_back), derivatives.transpose(to_back)

    def _evaluate_one(
        self, name: str, point: np.ndarray, weights: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """As `_evaluate`, of one point (P,)."""
        numbers = point.tolist()
        on = None if weights is None else weights.tolist()
        values = [0.0] * len(self.pattern)
        derivatives: list[float] = []
        for function, variables, constants, places in self._single:
            arguments = [[numbers[index] for index in variables], constants]
            if on is not None:
                arguments.append([on[place] for place in places])
            found = getattr(function, name)(*arguments)
            if on is None:
                for place, value in zip(places, found, strict=False):
                    values[place] = value
                found = found[len(places) :]
            derivatives += found
        return np.array(values), np.array(derivatives)

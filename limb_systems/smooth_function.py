"""Symbolic functions as numpy code, with exact first and second derivatives.

CasADi differentiates an expression and lists the elementary operations of the result. Each
operation becomes one line of Python, which numpy evaluates for all points at once, and Python's
own numbers for a single point, where numpy's overhead would be most of the time.
"""

import functools
import math
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from limb_systems.errors import LimbError

ca.GlobalOptions.setNumpyMode(1)  # numpy's functions of symbols return symbols

# Functions that CasADi, Python and numpy know, with numpy's name where it is another one.
_FUNCTIONS = {"acos": "arccos", "asin": "arcsin", "atan": "arctan", "atan2": "arctan2"}
_FUNCTIONS |= {
    name: name for name in ["cos", "cosh", "exp", "log", "sin", "sinh", "sqrt", "tan", "tanh"]
}
# Python code of CasADi's operations, by their names in CasADi.
_OPERATIONS = {
    **{name.upper(): f"{name}({{0}})" for name in _FUNCTIONS},
    "ATAN2": "atan2({0}, {1})",
    "ASSIGN": "{0}",
    "ADD": "{0} + {1}",
    "SUB": "{0} - {1}",
    "MUL": "{0} * {1}",
    "DIV": "{0} / {1}",
    "NEG": "-{0}",
    "SQ": "{0} * {0}",
    "TWICE": "{0} + {0}",
    "INV": "1.0 / {0}",
    "POW": "{0} ** {1}",
    "CONSTPOW": "{0} ** {1}",
    "FABS": "abs({0})",
    "SIGN": "sign({0})",
    "LT": "{0} < {1}",
    "LE": "{0} <= {1}",
    "AND": "{0} & {1}",
    "NOT": "negated({0})",
    "IF_ELSE_ZERO": "where({0}, {1}, 0.0)",
}
_CODES = {getattr(ca, f"OP_{name}"): code for name, code in _OPERATIONS.items()}
_OF_ARRAYS: dict[str, Any] = {
    **{name: getattr(np, in_numpy) for name, in_numpy in _FUNCTIONS.items()},
    **{"sign": np.sign, "negated": np.logical_not, "where": np.where},
    **{"inf": np.inf, "nan": np.nan},
}
_OF_NUMBERS: dict[str, Any] = {
    **{name: getattr(math, name) for name in _FUNCTIONS},
    "sign": lambda value: math.copysign(1.0, value) if value else 0.0,
    "negated": lambda condition: not condition,
    "where": lambda condition, value, other: value if condition else other,
    **{"inf": math.inf, "nan": math.nan},
}


# Instructions from which on CasADi evaluates an expression itself: numpy takes longer for each, and
# Python to compile them.
LONG = 12000


class Compiled:
    """Numpy code of symbolic expressions, or CasADi's own of long ones, of floats alone.

    Args:
        inputs: columns of symbols.
        outputs: expressions of them.

    Raises:
        LimbError: if an expression has an operation that is not smooth.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]):
        outputs = ca.cse(list(outputs))
        function = ca.Function("function", list(inputs), outputs)
        self._sizes = [output.nnz() for output in outputs]
        self._is_long = function.n_instructions() > LONG
        if self._is_long:
            dense = [output.nz[:] for output in outputs]
            self._machine = ca.Function("function", list(inputs), dense)
            return
        code = compile(_source(function), "<symbolic function>", "exec")
        self._of_numbers, self._of_arrays = (
            _defined(code, names) for names in (_OF_NUMBERS, _OF_ARRAYS)
        )

    def __call__(self, *inputs: np.ndarray) -> list[np.ndarray]:
        """Evaluate the expressions at any number of points.

        Args:
            inputs: the values of the inputs, each (size, ...), of floats or of one of Drake's
                scalar types, with equal shapes after the first axis.

        Returns:
            The nonzeros of each expression (Z, ...).
        """
        shape, dtype = inputs[0].shape[1:], np.result_type(*inputs)
        if self._is_long and 0 not in shape:
            flat = [values.reshape(len(values), -1) for values in inputs]
            found = self._machine.call(flat)
            return [values.full().reshape(-1, *shape) for values in found]
        if not shape and dtype.kind == "f":
            lists = [[0.0] * size for size in self._sizes]
            try:
                self._of_numbers(*(values.tolist() for values in inputs), *lists)
                return [np.array(values) for values in lists]
            except (ArithmeticError, ValueError):
                pass  # inf and nan, as for arrays
        results = [np.empty((size, *shape), dtype) for size in self._sizes]
        if self._is_long:
            return results  # of no points
        with np.errstate(all="ignore"):
            self._of_arrays(*inputs, *results)
        if dtype.hasobject:  # constants among the values, too, become one of Drake's scalars
            results = [values + 0.0 * inputs[0].flat[0] for values in results]
        return results


def _source(function: ca.Function) -> str:
    """The Python code of a CasADi function of inputs i0, ... that fills arrays o0, ..."""
    arguments = [f"i{number}" for number in range(function.n_in())]
    arguments += [f"o{number}" for number in range(function.n_out())]
    lines = [f"def function({', '.join(arguments)}):"]
    for number in range(function.n_instructions()):
        operation = function.instruction_id(number)
        inputs, outputs = function.instruction_input(number), function.instruction_output(number)
        if operation == ca.OP_OUTPUT:
            lines.append(f" o{outputs[0]}[{outputs[1]}] = w{inputs[0]}")
        elif operation == ca.OP_INPUT:
            lines.append(f" w{outputs[0]} = i{inputs[0]}[{inputs[1]}]")
        elif operation == ca.OP_CONST:
            lines.append(f" w{outputs[0]} = {function.instruction_constant(number)!r}")
        elif operation in _CODES:
            names = [f"w{place}" for place in inputs]
            lines.append(f" w{outputs[0]} = {_CODES[operation].format(*names)}")
        else:
            codes = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
            raise LimbError(
                f"A law of a wire uses {codes[operation].removeprefix('OP_').lower()}, which is "
                "not smooth; write it with powers, exp, log, tanh and the like."
            )
    return "\n".join([*lines, " return"])


def _defined(code: Any, names: dict[str, Any]) -> Callable[..., None]:
    scope = dict(names)
    exec(code, scope)
    return scope["function"]


_MOST_STATED = 16
_STATED: dict[Hashable, Any] = {}
T = TypeVar("T")


def stated_once(key: Hashable, state: Callable[[], T]) -> T:
    """Return what a function states in symbols, or what it returned for the same key before.

    Many objects describe the same limb, and differentiating and compiling takes longer than most of
    what they do. The last few results are kept.
    """
    if key not in _STATED:
        if len(_STATED) == _MOST_STATED:
            del _STATED[next(iter(_STATED))]
        _STATED[key] = state()
    return _STATED[key]


class SmoothFunction:
    """A function of points (..., P) with values (..., Q), and its exact derivatives.

    What is not needed is neither differentiated nor compiled.

    - ``num_values``, ``num_variables``: Q and P.
    - ``slope_places``: indices of value and variable of each derivative that may not be zero
      (2, Z).
    - ``curvature_places``: indices i >= j of the variables of each second derivative that may not
      be zero (2, Z).

    Args:
        values: expressions (Q,).
        point: their variables (P,).
        parameters: further symbols, by which nothing is differentiated.
    """

    def __init__(self, values: ca.SX, point: ca.SX, parameters: ca.SX | None = None):
        self._values, self._point = values, point
        self._others = [] if parameters is None else [parameters]
        self.num_values, self.num_variables = values.numel(), point.numel()

    @functools.cached_property
    def slope_places(self) -> np.ndarray:
        return _places(self._jacobian)

    @functools.cached_property
    def curvature_places(self) -> np.ndarray:
        return _places(self._hessian)

    def values(self, points: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """The values (..., Q)."""
        (values,) = self._compiled_values(*_inside(points, *parameters))
        return _outside(values)

    def first(self, points: np.ndarray, *parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values (..., Q), and their derivatives by the points (..., Q, P)."""
        values, slopes = self._compiled_first(*_inside(points, *parameters))
        result = np.zeros((*points.shape[:-1], self.num_values, self.num_variables), slopes.dtype)
        rows, columns = self.slope_places
        result[..., rows, columns] = _outside(slopes)
        return _outside(values), result

    def second(
        self, points: np.ndarray, weights: np.ndarray, *parameters: np.ndarray
    ) -> np.ndarray:
        """Second derivatives (..., P, P) of weights · values, for weights (..., Q)."""
        curved = self.curvatures(points, weights, *parameters)
        result = np.zeros((*points.shape, self.num_variables))
        rows, columns = self.curvature_places
        result[..., rows, columns] = curved
        result[..., columns, rows] = curved
        return result

    def slopes(self, points: np.ndarray) -> np.ndarray:
        """Derivatives by the points at the ``slope_places`` (..., Z)."""
        return _outside(self._compiled_first(*_inside(points))[1])

    def curvatures(
        self, points: np.ndarray, weights: np.ndarray, *parameters: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of weights · values at the ``curvature_places`` (..., Z)."""
        (curved,) = self._compiled_second(*_inside(points, weights, *parameters))
        return _outside(curved)

    @functools.cached_property
    def _jacobian(self) -> ca.SX:
        return ca.jacobian(self._values, self._point)

    @functools.cached_property
    def _weights(self) -> ca.SX:
        return ca.SX.sym("w", self.num_values)

    @functools.cached_property
    def _hessian(self) -> ca.SX:
        """The lower triangle of the Hessian of weights · values."""
        return ca.tril(ca.hessian(ca.dot(self._weights, self._values), self._point)[0])

    @functools.cached_property
    def _compiled_values(self) -> Compiled:
        return Compiled([self._point, *self._others], [ca.densify(self._values)])

    @functools.cached_property
    def _compiled_first(self) -> Compiled:
        outputs = [ca.densify(self._values), self._jacobian]
        return Compiled([self._point, *self._others], outputs)

    @functools.cached_property
    def _compiled_second(self) -> Compiled:
        return Compiled([self._point, self._weights, *self._others], [self._hessian])


def _inside(*arrays: np.ndarray) -> Sequence[np.ndarray]:
    """Arrays (..., size) as (size, ...) with equal points, in memory in this order."""
    shape = arrays[0].shape[:-1]
    if not shape and all(array.ndim == 1 for array in arrays):
        return arrays
    if any(array.shape[:-1] != shape for array in arrays):
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
        arrays = tuple(np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays)
    to_front = (len(shape), *range(len(shape)))
    return [np.ascontiguousarray(array.transpose(to_front)) for array in arrays]


def _outside(values: np.ndarray) -> np.ndarray:
    """An array (size, ...) as (..., size)."""
    return values.transpose(*range(1, values.ndim), 0)


def _places(expression: ca.SX) -> np.ndarray:
    """Rows and columns of the nonzeros (2, Z)."""
    return np.array(expression.sparsity().get_triplet(), int)

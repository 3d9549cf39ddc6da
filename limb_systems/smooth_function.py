"""Symbolic functions as numpy code, with exact first and second derivatives.

CasADi differentiates an expression and lists the elementary operations of the result. Numpy
evaluates each operation for all points at once. For a single point, where numpy's overhead would be
most of the time, each operation becomes one line of Python for its own numbers.
"""

import functools
import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from limb_systems.errors import LimbError

ca.GlobalOptions.setNumpyMode(1)  # numpy's functions of symbols return symbols

# CasADi's operations by their names: the code in Python, and what numpy calls for arrays.
_FUNCTIONS = {"acos": "arccos", "asin": "arcsin", "atan": "arctan"}
_FUNCTIONS |= {
    name: name for name in ["cos", "cosh", "exp", "log", "sin", "sinh", "sqrt", "tan", "tanh"]
}


def _copy(value: np.ndarray, out: np.ndarray) -> None:
    out[...] = value


def _where(condition: np.ndarray, value: np.ndarray, out: np.ndarray) -> None:
    out[...] = np.where(condition, value, 0.0)


_OPERATIONS: dict[str, tuple[str, Callable[..., Any]]] = {
    **{
        name.upper(): (f"{name}({{0}})", getattr(np, in_numpy))
        for name, in_numpy in _FUNCTIONS.items()
    },
    "ATAN2": ("atan2({0}, {1})", np.arctan2),
    "ASSIGN": ("{0}", _copy),
    "ADD": ("{0} + {1}", np.add),
    "SUB": ("{0} - {1}", np.subtract),
    "MUL": ("{0} * {1}", np.multiply),
    "DIV": ("{0} / {1}", np.divide),
    "NEG": ("-{0}", np.negative),
    "SQ": ("{0} * {0}", np.square),
    "TWICE": ("{0} + {0}", lambda value, out: np.add(value, value, out)),
    "INV": ("1.0 / {0}", lambda value, out: np.divide(1.0, value, out)),
    "POW": ("{0} ** {1}", np.power),
    "CONSTPOW": ("{0} ** {1}", np.power),
    "FABS": ("abs({0})", np.absolute),
    "SIGN": ("sign({0})", np.sign),
    "LT": ("{0} < {1}", np.less),
    "LE": ("{0} <= {1}", np.less_equal),
    "AND": ("{0} and {1}", np.logical_and),
    "NOT": ("not {0}", np.logical_not),
    "IF_ELSE_ZERO": ("{1} if {0} else 0.0", _where),
}
_OPERATION_BY_CODE = {
    getattr(ca, f"OP_{name}"): operation for name, operation in _OPERATIONS.items()
}
_SCALAR_FUNCTIONS: dict[str, Any] = {
    **{name: getattr(math, name) for name in [*_FUNCTIONS, "atan2"]},
    "sign": lambda value: math.copysign(1.0, value) if value else 0.0,
    **{"inf": math.inf, "nan": math.nan},
}

# CasADi evaluates expressions of so many instructions itself where points are few, because numpy
# takes longer for each instruction, and Python to compile them.
LONG, FEW = 12000, 100
CHUNK = 1024  # points that numpy evaluates at once, so that they stay in the processor's cache


class Compiled:
    """Symbolic expressions as a list of instructions for arrays, and as Python code for numbers.

    Args:
        inputs: columns of symbols.
        outputs: expressions of them.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]):
        dense = [output.nz[:] for output in ca.cse(list(outputs))]
        self._function = function = ca.Function("function", list(inputs), dense)
        self._sizes = [output.numel() for output in dense]
        self._is_long = function.n_instructions() > LONG

    def __call__(self, *inputs: np.ndarray) -> list[np.ndarray]:
        """Evaluate the expressions at any number of points.

        Args:
            inputs: the values of the inputs, each (size, ...), of floats or of one of Drake's
                scalar types, with equal shapes after the first axis.

        Returns:
            The nonzeros of each expression (Z, ...).

        Raises:
            LimbError: if an expression has an operation that is not smooth.
        """
        shape, dtype = inputs[0].shape[1:], np.result_type(*inputs)
        if not shape and not self._is_long and dtype.kind == "f":
            lists = [[0.0] * size for size in self._sizes]
            try:
                self._scalar_code(*(values.tolist() for values in inputs), *lists)
                return [np.array(values) for values in lists]
            except (ArithmeticError, ValueError):
                pass  # inf and nan, as for arrays
        flat = [values.reshape(len(values), -1) for values in inputs]
        num_points = flat[0].shape[1]
        if self._is_long and 0 < num_points < FEW and dtype.kind == "f":
            found = self._function.call(flat)
            return [values.full().reshape(-1, *shape) for values in found]
        results = [np.empty((size, num_points), dtype) for size in self._sizes]
        with np.errstate(all="ignore"):
            for start in range(0, num_points, CHUNK):
                part = slice(start, start + CHUNK)
                self._fill([values[:, part] for values in (*flat, *results)], dtype)
        if dtype.hasobject:  # constants among the values, too, become one of Drake's scalars
            results = [values + 0.0 * inputs[0].flat[0] for values in results]
        return [values.reshape(-1, *shape) for values in results]

    def _fill(self, arrays: Sequence[np.ndarray], dtype: np.dtype) -> None:
        """Evaluate the instructions at some points, from the inputs into the results."""
        num_registers, constants, steps = self._instruction_list
        rows = [*np.empty((num_registers, arrays[0].shape[1]), dtype), *constants]
        for values in arrays:
            rows.extend(values)
        for operation, first, second, to in steps:
            if second < 0:
                operation(rows[first], rows[to])
            else:
                operation(rows[first], rows[second], rows[to])

    @functools.cached_property
    def _instruction_list(self) -> tuple[int, list[float], list[tuple]]:
        """Number of registers, constants, and steps (operation, first, second or -1, to).

        Operands are numbers of rows: the registers', then the constants, and those of inputs and
        outputs.
        """
        instructions = list(_instruction_list(self._function))
        constants = [value for code, value, _ in instructions if code == ca.OP_CONST]
        num_registers = self._function.sz_w()
        sizes = [self._function.numel_in(k) for k in range(self._function.n_in())] + self._sizes
        starts = num_registers + len(constants) + np.cumsum([0, *sizes])
        inputs, outputs = np.split(starts[:-1], [self._function.n_in()])
        # A register stands for the row of an input or a constant until something is written to it.
        row_of = list(range(num_registers))
        steps: list[tuple] = []
        next_constant = num_registers
        for code, operands, to in instructions:
            if code == ca.OP_CONST:
                row_of[to[0]] = next_constant
                next_constant += 1
            elif code == ca.OP_INPUT:
                row_of[to[0]] = int(inputs[operands[0]]) + operands[1]
            elif code == ca.OP_OUTPUT:
                row = int(outputs[to[0]]) + to[1]
                steps.append((_copy, row_of[operands[0]], -1, row))
            else:
                first, second = (*(row_of[place] for place in operands), -1)[:2]
                steps.append((_operation(code)[1], first, second, to[0]))
                row_of[to[0]] = to[0]
        return num_registers, constants, steps

    @functools.cached_property
    def _scalar_code(self) -> Callable[..., None]:
        """The code of a function that fills lists o0, ... from lists of numbers i0, ..."""
        function, scope = self._function, dict(_SCALAR_FUNCTIONS)
        arguments = [f"i{number}" for number in range(function.n_in())]
        arguments += [f"o{number}" for number in range(function.n_out())]
        lines = [f"def function({', '.join(arguments)}):"]
        for code, operands, to in _instruction_list(function):
            if code == ca.OP_OUTPUT:
                lines.append(f" o{to[0]}[{to[1]}] = w{operands[0]}")
            elif code == ca.OP_INPUT:
                lines.append(f" w{to[0]} = i{operands[0]}[{operands[1]}]")
            elif code == ca.OP_CONST:
                lines.append(f" w{to[0]} = {operands!r}")
            else:
                names = [f"w{place}" for place in operands]
                lines.append(f" w{to[0]} = {_operation(code)[0].format(*names)}")
        exec("\n".join([*lines, " return"]), scope)
        return scope["function"]


def _instruction_list(function: ca.Function) -> Iterator[tuple]:
    """The code, the operands, or the constant, and the places of the result of each instruction."""
    for number in range(function.n_instructions()):
        code = function.instruction_id(number)
        operands = (
            function.instruction_constant(number)
            if code == ca.OP_CONST
            else function.instruction_input(number)
        )
        yield code, operands, function.instruction_output(number)


def _operation(code: int) -> tuple[str, Callable[..., Any]]:
    """The Python code and numpy's function of one of CasADi's operations."""
    if code in _OPERATION_BY_CODE:
        return _OPERATION_BY_CODE[code]
    names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
    raise LimbError(
        f"A law of a wire uses {names[code].removeprefix('OP_').lower()}, which is not smooth; "
        "write it with powers, exp, log, tanh and the like."
    )


_MAX_CACHED = 48
_CACHE: dict[Hashable, Any] = {}
T = TypeVar("T")


def build_once(key: Hashable, state: Callable[[], T]) -> T:
    """Return what a function states in symbols, or what it returned for the same key before.

    Many objects describe the same limb, and differentiating and compiling takes longer than most of
    what they do. The last few results are kept.
    """
    if key not in _CACHE:
        if len(_CACHE) == _MAX_CACHED:
            del _CACHE[next(iter(_CACHE))]
        _CACHE[key] = state()
    return _CACHE[key]


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
        (values,) = self._compiled_values(*_points_last(points, *parameters))
        return _points_first(values)

    def first(self, points: np.ndarray, *parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The values (..., Q), and their derivatives by the points (..., Q, P)."""
        values, slopes = self._compiled_first(*_points_last(points, *parameters))
        result = np.zeros((*points.shape[:-1], self.num_values, self.num_variables), slopes.dtype)
        rows, columns = self.slope_places
        result[..., rows, columns] = _points_first(slopes)
        return _points_first(values), result

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

    def slopes(self, points: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """Derivatives by the points at the ``slope_places`` (..., Z)."""
        return _points_first(self._compiled_first(*_points_last(points, *parameters))[1])

    def curvatures(
        self, points: np.ndarray, weights: np.ndarray, *parameters: np.ndarray
    ) -> np.ndarray:
        """Second derivatives of weights · values at the ``curvature_places`` (..., Z)."""
        (curved,) = self._compiled_second(*_points_last(points, weights, *parameters))
        return _points_first(curved)

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


def _points_last(*arrays: np.ndarray) -> Sequence[np.ndarray]:
    """Arrays (..., size) as (size, ...) with equal points, in memory in this order."""
    shape = arrays[0].shape[:-1]
    if not shape and all(array.ndim == 1 for array in arrays):
        return arrays
    if any(array.shape[:-1] != shape for array in arrays):
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
        arrays = tuple(np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays)
    to_front = (len(shape), *range(len(shape)))
    return [np.ascontiguousarray(array.transpose(to_front)) for array in arrays]


def _points_first(values: np.ndarray) -> np.ndarray:
    """An array (size, ...) as (..., size)."""
    return values.transpose(*range(1, values.ndim), 0)


def _places(expression: ca.SX) -> np.ndarray:
    """Rows and columns of the nonzeros (2, Z)."""
    return np.array(expression.sparsity().get_triplet(), int)

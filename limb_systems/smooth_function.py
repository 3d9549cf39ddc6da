"""Symbolic functions as numpy code, with exact first and second derivatives.

CasADi differentiates an expression and lists the elementary operations of the result. Numpy
evaluates each operation for all points at once. For few points, where numpy's overhead would be
most of the time, CasADi evaluates the operations itself.
"""

import functools
import itertools
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from limb_systems.errors import LimbError

ca.GlobalOptions.setNumpyMode(1)  # numpy's functions of symbols return symbols


def _copy(value: np.ndarray, out: np.ndarray) -> None:
    """Copy a value into an array, as numpy's functions write their results."""
    out[...] = value


def _where(condition: np.ndarray, value: np.ndarray, out: np.ndarray) -> None:
    """Write the value where the condition holds, else zero."""
    out[...] = np.where(condition, value, 0.0)


# CasADi's operations by their names, as numpy's functions.
_OPERATIONS: dict[str, Callable[..., Any]] = {
    "ACOS": np.arccos,
    "ASIN": np.arcsin,
    "ATAN": np.arctan,
    "ATAN2": np.arctan2,
    "COS": np.cos,
    "COSH": np.cosh,
    "EXP": np.exp,
    "LOG": np.log,
    "SIN": np.sin,
    "SINH": np.sinh,
    "SQRT": np.sqrt,
    "TAN": np.tan,
    "TANH": np.tanh,
    "ASSIGN": _copy,
    "ADD": np.add,
    "SUB": np.subtract,
    "MUL": np.multiply,
    "DIV": np.divide,
    "NEG": np.negative,
    "SQ": np.square,
    "TWICE": lambda value, out: np.add(value, value, out),
    "INV": lambda value, out: np.divide(1.0, value, out),
    "POW": np.power,
    "CONSTPOW": np.power,
    "FABS": np.absolute,
}
# Operations that jump, which a law of a wire must not use.
_JUMPS: dict[str, Callable[..., Any]] = {
    "SIGN": np.sign,
    "LT": np.less,
    "LE": np.less_equal,
    "AND": np.logical_and,
    "NOT": np.logical_not,
    "IF_ELSE_ZERO": _where,
}
_OPERATION_BY_CODE = {
    getattr(ca, f"OP_{name}"): operation for name, operation in (_OPERATIONS | _JUMPS).items()
}
_CODES_OF_LAWS = {getattr(ca, f"OP_{name}") for name in ("CONST", "INPUT", "OUTPUT", *_OPERATIONS)}

# CasADi evaluates fewer points than these: numpy takes half a microsecond for each instruction.
FEW_POINTS = 40
FEW_BOUND_POINTS = 100  # of a bound function, which has no overhead
# CasADi evaluates so many points before numpy does: listing an instruction takes as long.
POINTS_BEFORE_LISTING = 1000
# In longer functions, CasADi takes 30 ms and more for a search of equal subexpressions, which are a
# few per cent of them.
MAX_SEARCHED_INSTRUCTIONS = 4000
_POINT_LOCK = threading.RLock()
CHUNK = 1500  # points that numpy evaluates at once, so that they stay in the processor's cache


class Compiled:
    """Symbolic expressions as a list of instructions for numpy, and as a function of CasADi.

    Args:
        inputs: columns of symbols.
        outputs: expressions of them.
    """

    def __init__(self, inputs: Sequence[ca.SX], outputs: Sequence[ca.SX]):
        dense = [ca.vec(output.nz[:]) for output in outputs]
        self._function = ca.Function("function", list(inputs), dense)
        # Find equal subexpressions, unless that takes longer than their evaluation.
        if self._function.n_instructions() < MAX_SEARCHED_INSTRUCTIONS:
            self._function = ca.Function("function", list(inputs), ca.cse(dense))
        self._input_sizes = [symbols.numel() for symbols in inputs]
        self._sizes = [output.numel() for output in dense]
        self._num_points_by_casadi = 0
        self._mapped = {1: self._function}  # by the number of points

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
        shape = inputs[0].shape[1:]
        dtype = np.result_type(*inputs)
        # Evaluate few points in CasADi, or as many as cost less than listing the instructions.
        if not shape and dtype.kind == "f":
            return self._evaluate_point(inputs)
        flat = [values.reshape(len(values), -1) for values in inputs]
        num_points = flat[0].shape[1]
        total = self._num_points_by_casadi + num_points
        is_cheap = num_points < FEW_POINTS or total < POINTS_BEFORE_LISTING
        if num_points and is_cheap and dtype.kind == "f":
            self._num_points_by_casadi = total
            outputs = self._function.call(flat)
            return [values.full().reshape(-1, *shape) for values in outputs]
        # Evaluate all others in numpy, in chunks of about the same size.
        num_chunks = -(-num_points // CHUNK)
        ends = np.linspace(0, num_points, num_chunks + 1).astype(int).tolist()
        results = [np.empty((size, num_points), dtype) for size in self._sizes]
        with np.errstate(all="ignore"):
            for start, end in itertools.pairwise(ends):
                part = slice(start, end)
                self._bound_in_numpy([values[:, part] for values in (*flat, *results)])()
        if dtype.hasobject:  # constants among the values, too, become one of Drake's scalars
            results = [values + 0.0 * inputs[0].flat[0] for values in results]
        return [values.reshape(-1, *shape) for values in results]

    def _evaluate_point(self, inputs: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Evaluate the expressions at a single point, without CasADi's own arrays."""
        arguments, results, evaluate = self._bound_point
        with _POINT_LOCK:  # threads share the arrays
            for argument, values in zip(arguments, inputs, strict=True):
                argument[:, 0] = values
            evaluate()
            return [values[:, 0].copy() for values in results]

    @functools.cached_property
    def _bound_point(self) -> tuple[list[np.ndarray], list[np.ndarray], Callable[[], None]]:
        """The arrays that a bound function of one point reads and fills, and the function."""
        arguments = [np.zeros((size, 1)) for size in self._input_sizes]
        results = [np.zeros((size, 1)) for size in self._sizes]
        return arguments, results, self.bound(*arguments, *results)

    def bound(self, *arrays: np.ndarray) -> Callable[[], None]:
        """Return a function that evaluates the expressions from some arrays into others.

        Args:
            arrays: the values of the inputs, then of the outputs, each (size, points), contiguous.
        """
        num_points = arrays[0].shape[1]
        if num_points < FEW_BOUND_POINTS:
            return self._bound_in_casadi(num_points, arrays)
        return self._bound_in_numpy(arrays)

    def _bound_in_casadi(self, num_points: int, arrays: Sequence[np.ndarray]) -> Callable[[], None]:
        """Return a function from arrays into others, which CasADi evaluates point after point."""
        # CasADi has a point in each column, in memory one after the other.
        if num_points not in self._mapped:
            inputs = [ca.MX.sym("i", num_points, size) for size in self._input_sizes]
            outputs = self._function.map(num_points).call([each.T for each in inputs])
            self._mapped[num_points] = ca.Function("mapped", inputs, [each.T for each in outputs])
        buffer: Any
        buffer, evaluate = self._mapped[num_points].buffer()
        for number, values in enumerate(arrays[: len(arrays) - len(self._sizes)]):
            buffer.set_arg(number, values.data)
        for number, values in enumerate(arrays[-len(self._sizes) :]):
            buffer.set_res(number, values.data)

        def evaluate_at_points(_memory: object = (buffer, arrays)) -> None:  # which CasADi uses
            evaluate()

        return evaluate_at_points

    def _bound_in_numpy(self, arrays: Sequence[np.ndarray]) -> Callable[[], None]:
        """Return a function from arrays into others, which numpy evaluates for all points."""
        num_registers, constants, steps = self._array_code
        # The operands of the steps: registers, constants, inputs and outputs.
        rows = [*np.empty((num_registers, arrays[0].shape[1]), arrays[-1].dtype), *constants]
        for values in arrays:
            rows.extend(values)

        def evaluate() -> None:
            for operation, first, second, target in steps:
                if second < 0:
                    operation(rows[first], rows[target])
                else:
                    operation(rows[first], rows[second], rows[target])

        return evaluate

    @functools.cached_property
    def _array_code(self) -> tuple[int, list[float], list[tuple]]:
        """The number of registers, constants, and steps (operation, first, second or -1, target).

        Operands are numbers of rows: rows of registers, then of constants, inputs and outputs.
        """
        # Number the rows.
        function = self._function
        instructions = list(_instruction_list(function))
        constants = [value for code, value, _ in instructions if code == ca.OP_CONST]
        num_registers = function.sz_w()
        sizes = self._input_sizes + self._sizes
        starts = num_registers + len(constants) + np.cumsum([0, *sizes])
        input_starts, output_starts = np.split(starts[:-1], [len(self._input_sizes)])
        # A register stands for the row of an input or a constant until something is written to it.
        row_of_register = list(range(num_registers))
        next_constant = num_registers
        steps: list[tuple] = []
        for code, operands, target in instructions:
            if code == ca.OP_CONST:
                row_of_register[target[0]] = next_constant
                next_constant += 1
            elif code == ca.OP_INPUT:
                row_of_register[target[0]] = int(input_starts[operands[0]]) + operands[1]
            elif code == ca.OP_OUTPUT:
                row = int(output_starts[target[0]]) + target[1]
                steps.append((_copy, row_of_register[operands[0]], -1, row))
            else:
                rows = [row_of_register[register] for register in operands]
                second = rows[1] if len(rows) > 1 else -1
                steps.append((_operation(code), rows[0], second, target[0]))
                row_of_register[target[0]] = target[0]
        return num_registers, constants, steps


def _instruction_list(function: ca.Function) -> Iterator[tuple]:
    """Yield the code, the operands or the constant, and the targets of each instruction."""
    for number in range(function.n_instructions()):
        code = function.instruction_id(number)
        operands = (
            function.instruction_constant(number)
            if code == ca.OP_CONST
            else function.instruction_input(number)
        )
        yield code, operands, function.instruction_output(number)


def check_smooth(function: ca.Function) -> None:
    """Raise LimbError if a function uses an operation that is not smooth."""
    for number in range(function.n_instructions()):
        code = function.instruction_id(number)
        if code not in _CODES_OF_LAWS:
            raise _not_smooth_error(code)


def _operation(code: int) -> Callable[..., Any]:
    """Return numpy's function of one of CasADi's operations."""
    if code not in _OPERATION_BY_CODE:
        raise _not_smooth_error(code)
    return _OPERATION_BY_CODE[code]


def _not_smooth_error(code: int) -> LimbError:
    names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
    return LimbError(
        f"A law of a wire uses {names[code].removeprefix('OP_').lower()}, which is not smooth; "
        "write it with powers, exp, log, tanh and the like."
    )


_MAX_CACHED = 48
_CACHE: dict[Hashable, Any] = {}
T = TypeVar("T")


def build_once(key: Hashable, build: Callable[[], T]) -> T:
    """Return what a function builds, or built before for the same key.

    Many objects describe the same limb, and differentiating and compiling takes longer than most of
    their work. The last few results are kept.
    """
    if key in _CACHE:
        return _CACHE[key]
    # What is built may build other things once.
    result = build()
    _CACHE[key] = result
    while len(_CACHE) > _MAX_CACHED:
        del _CACHE[next(iter(_CACHE))]
    return result


class SmoothFunction:
    """A function of points (..., P) with values (..., Q), and its exact derivatives.

    Derivatives are formed and compiled when they are first needed.

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
        self._values = values
        self._point = point
        self._parameters = [] if parameters is None else [parameters]
        self.num_values = values.numel()
        self.num_variables = point.numel()

    @functools.cached_property
    def slope_places(self) -> np.ndarray:
        return _places(self._jacobian)

    @functools.cached_property
    def curvature_places(self) -> np.ndarray:
        return _places(self._hessian)

    def bound(self, points: np.ndarray, values: np.ndarray) -> Callable[[], None]:
        """Return a function that evaluates points (P, n) from an array into values (Q, n).

        The function has no parameters, and the arrays are contiguous.
        """
        return self._compiled_values.bound(points, values)

    def values(self, points: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """Return the values (..., Q)."""
        (values,) = self._compiled_values(*_points_last(points, *parameters))
        return _points_first(values)

    def first(self, points: np.ndarray, *parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (..., Q), and their derivatives by the points (..., Q, P)."""
        values, slopes = self._compiled_first(*_points_last(points, *parameters))
        result = np.zeros((*points.shape[:-1], self.num_values, self.num_variables), slopes.dtype)
        rows, columns = self.slope_places
        result[..., rows, columns] = _points_first(slopes)
        return _points_first(values), result

    def second(
        self, points: np.ndarray, weights: np.ndarray, *parameters: np.ndarray
    ) -> np.ndarray:
        """Return second derivatives (..., P, P) of weights · values, for weights (..., Q)."""
        curved = self.curvatures(points, weights, *parameters)
        result = np.zeros((*points.shape, self.num_variables))
        rows, columns = self.curvature_places
        result[..., rows, columns] = curved
        result[..., columns, rows] = curved
        return result

    def dense_slopes(self, points: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """Return the derivatives by the points (..., Q, P)."""
        return self.first(points, *parameters)[1]

    def slopes(self, points: np.ndarray, *parameters: np.ndarray) -> np.ndarray:
        """Return derivatives by the points at the ``slope_places`` (..., Z)."""
        return _points_first(self._compiled_first(*_points_last(points, *parameters))[1])

    def curvatures(
        self, points: np.ndarray, weights: np.ndarray, *parameters: np.ndarray
    ) -> np.ndarray:
        """Return second derivatives of weights · values at the ``curvature_places`` (..., Z)."""
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
        return Compiled([self._point, *self._parameters], [ca.densify(self._values)])

    @functools.cached_property
    def _compiled_first(self) -> Compiled:
        outputs = [ca.densify(self._values), self._jacobian]
        return Compiled([self._point, *self._parameters], outputs)

    @functools.cached_property
    def _compiled_second(self) -> Compiled:
        return Compiled([self._point, self._weights, *self._parameters], [self._hessian])


def _points_last(*arrays: np.ndarray) -> Sequence[np.ndarray]:
    """Return arrays (..., size) as (size, ...) with equal points, in memory in this order."""
    shape = arrays[0].shape[:-1]
    if not shape and all(array.ndim == 1 for array in arrays):
        return arrays
    # Broadcast the points, and move the last axis to the front.
    if any(array.shape[:-1] != shape for array in arrays):
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
        arrays = tuple(np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays)
    to_front = (len(shape), *range(len(shape)))
    return [np.ascontiguousarray(array.transpose(to_front)) for array in arrays]


def _points_first(values: np.ndarray) -> np.ndarray:
    """Return an array (size, ...) as (..., size)."""
    return values.transpose(*range(1, values.ndim), 0)


def _places(expression: ca.SX) -> np.ndarray:
    """Return rows and columns of the nonzeros (2, Z)."""
    return np.array(expression.sparsity().get_triplet(), int)

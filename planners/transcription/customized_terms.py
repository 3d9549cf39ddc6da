"""Terms that a task's ``customize`` added: names of costs and constraints, and active ones."""

import re
import textwrap
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from pydrake.solvers import Binding, LinearConstraint

from planners.transcription.ipopt import gradient_of

# A constraint is active if a change of its variables by this share of their scales takes it to a
# bound.
BOUND_TOLERANCE = 1e-3
MAX_FORMULA_VARIABLES = 10  # variables; with more of them a formula takes long to write


def describe(binding: Binding) -> str:
    """Return the description of a cost or constraint on one line, or else its formula."""
    evaluator = binding.evaluator()
    num_variables = len(binding.variables())
    if description := " ".join(evaluator.get_description().split()):
        return description
    if num_variables > MAX_FORMULA_VARIABLES:
        return f"{type(evaluator).__name__} of {num_variables} variables"
    kind, _, formula = str(binding).partition("\n")
    formula = re.sub(r"\d+\.\d{4,}", lambda number: f"{float(number[0]):.3g}", formula or kind)
    return textwrap.shorten(formula, 100)


def group_by_name(bindings: Sequence[Binding]) -> dict[str, list[Binding]]:
    """Return groups of costs or constraints by their descriptions.

    Terms without a description are grouped if their formulas differ by numbers alone, under the
    formula of the first one.
    """
    groups: dict[str, list[Binding]] = {}
    for binding in bindings:
        name = describe(binding)
        if not binding.evaluator().get_description():
            name = re.sub(r"\d[\d.,]*(e[-+]\d+)?", "", name)
        groups.setdefault(name, []).append(binding)
    named = {}
    for key, members in groups.items():
        first = describe(members[0])
        named[first if key == first or len(members) == 1 else f"{first} and alike"] = members
    return named


def variables_at_bounds(binding: Binding, x: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return which variables the active rows of a constraint depend on.

    Args:
        x: values of its variables (m,).
        scales: typical changes of its variables (m,).

    Returns:
        Places among its variables, some of them repeatedly.
    """
    evaluator = binding.evaluator()
    is_linear = isinstance(evaluator, LinearConstraint)
    jacobian = evaluator.get_sparse_A() if is_linear else gradient_of(evaluator, x)
    rows, columns, slopes = scipy.sparse.find(jacobian)
    values = evaluator.Eval(x)
    slack = np.minimum(values - evaluator.lower_bound(), evaluator.upper_bound() - values)
    reach = np.sqrt(np.bincount(rows, (slopes * scales[columns]) ** 2, len(slack)))
    return columns[(slack <= BOUND_TOLERANCE * reach)[rows]]

#!/bin/sh
# Drake returns the solution of a matrix of one column as a vector, which numpy then broadcasts.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

from pydrake.solvers import MathematicalProgram, Solve

program = MathematicalProgram()
two_columns, one_column = (program.NewContinuousVariables(3, n, "x") for n in (2, 1))
program.AddBoundingBoxConstraint(1.0, 1.0, two_columns)
program.AddBoundingBoxConstraint(1.0, 1.0, one_column)
result = Solve(program)
shapes = [result.GetSolution(x).shape for x in (two_columns, one_column)]
print("Drake", version("drake"))
print("guess:  GetSolution has the shape of what it is asked for, (3, 2) and (3, 1)")
print("result:", *shapes, "- a sum with the (3, 1) guess is (3, 3), without an error")
assert shapes == [(3, 2), (3,)]
assert (one_column + result.GetSolution(one_column)).shape == (3, 3)
PY

#!/bin/sh
# float() of a CasADi symbol of the kind SX is nan, without an error: a branch on it has one side.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check casadi==3.8.2
"$folder/bin/python" - <<'PY'
import math

import casadi as ca


def cooling(temperature):
    """Cool twice as fast above 40."""
    return 2.0 * temperature if float(temperature) > 40.0 else temperature


x = ca.SX.sym("x")
y = ca.MX.sym("y")
in_symbols = ca.Function("cooling", [x], [cooling(x)])
print("CasADi", ca.__version__)
print("guess:  float() of a symbol is refused, as that of an MX is, and as `if x > 40` is")
print("result:", float(x), "- and the function of a branch has one side:", end=" ")
print(cooling(100.0), "in numbers,", float(in_symbols(100.0)), "in symbols")
assert math.isnan(float(x))
assert math.isnan(math.exp(x))
assert (cooling(100.0), float(in_symbols(100.0))) == (200.0, 100.0)
refused = []
for name, call in (("MX", lambda: float(y)), ("comparison", lambda: bool(x > 40.0))):
    try:
        call()
    except RuntimeError:
        refused.append(name)
print("refused:", *refused)
assert refused == ["MX", "comparison"]
PY

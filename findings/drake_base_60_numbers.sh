#!/bin/sh
# Drake's YAML is version 1.1: a number with a colon is in base 60, and one with a leading 0 is octal.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

from pydrake.common.yaml import yaml_load_typed
from pydrake.systems.analysis import SimulatorConfig


def step(text: str) -> float:
    return yaml_load_typed(
        schema=SimulatorConfig, data=f"max_step_size: {text}", defaults=SimulatorConfig()
    ).max_step_size


print("Drake", version("drake"))
print("guess:  a typed loader refuses 1:30 for a float, and reads 010 as 10")
print("result:", step("1:30"), "and", step("010"))
assert (step("1:30"), step("010")) == (90.0, 8.0)
PY

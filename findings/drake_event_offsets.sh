#!/bin/sh
# Drake fires two events of one period at other instants if one of them begins a period later.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
${PYTHON:-python3} -m venv "$folder"
"$folder/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$folder/bin/python" - <<'PY'
from importlib.metadata import version

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

PERIOD = 0.05  # s
END = 20.0  # s


class Clock(LeafSystem):
    """A periodic event, and a continuous state whose time is integrated."""

    def __init__(self, offset: float):
        LeafSystem.__init__(self)
        self.times: list[float] = []
        self.DeclareContinuousState(1)
        self.DeclarePeriodicPublishEvent(PERIOD, offset, self.note_time)

    def note_time(self, context) -> None:
        self.times.append(context.get_time())

    def DoCalcTimeDerivatives(self, context, derivatives) -> None:
        state = context.get_continuous_state_vector()[0]
        derivatives.get_mutable_vector().SetAtIndex(0, -state)


def steps_and_differences(offset: float) -> tuple[int, int, float]:
    """Return the steps with a clock beside one without offset, and how many ticks are apart."""
    builder = DiagramBuilder()
    first = builder.AddSystem(Clock(0.0))
    other = builder.AddSystem(Clock(offset))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(END)
    apart = sorted(set(other.times) - set(first.times))
    nearest = [np.abs(np.array(first.times) - time).min() for time in apart]
    return simulator.get_num_steps_taken(), len(apart), max(nearest, default=0.0)


print("Drake", version("drake"))
print("guess:  events of 50 ms, one of them from 50 ms on, fire together from then on")
steps, apart, _ = steps_and_differences(0.0)
assert apart == 0
more_steps, apart, farthest = steps_and_differences(PERIOD)
print(
    f"result: of 400 ticks {apart} are up to {farthest:.0e} s apart, as offset + k * period is "
    f"rounded otherwise, and steps of that length are added: {more_steps} in place of {steps}"
)
assert apart > 50
assert 0.0 < farthest < 1e-12
assert more_steps > steps + 50
PY

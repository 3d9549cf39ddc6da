"""What a limb may meet after its calibration, and what its sensors may do."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Diagram, LeafSystem, System

from limb_systems.model.limb_system import behind
from limb_systems.model.ownership import weak_method
from limb_systems.simulation import PERIOD

# Of the limb, as of `Specimen.disturbed`.
LIMB_DISTURBANCES: dict[str, dict[str, float]] = {
    "none": {},
    "room +5 °C": {"ambient": 5.0},
    "room -5 °C": {"ambient": -5.0},
    "payload +5°": {"payload": np.deg2rad(5.0)},
    "payload -5°": {"payload": np.deg2rad(-5.0)},
    "stiffness +20%": {"stiffness": 1.2},
    "stiffness -20%": {"stiffness": 0.8},
    "fan, cooling +30%": {"cooling": 1.3},
    "supply +10%": {"supply": 1.1},
    "supply -10%": {"supply": 0.9},
    "twice the bend sensor's noise": {"noise": 2.0},
}
# Of the reading of the bend, as of `BendPath`; an absence is in mid motion.
SENSOR_DISTURBANCES = {
    "bend read 0.1 s later": {"delay": 0.1},
    "no bend for 2 s": {"absence": 2.0},
    "bend held for 2 s": {"absence": 2.0, "held": True},
}
WRONG_CALIBRATION = "gains of the nominal limb"
DISTURBANCES = (*LIMB_DISTURBANCES, *SENSOR_DISTURBANCES, WRONG_CALIBRATION)


class BendPath(LeafSystem):
    """The way of the bend's reading to a controller, which takes time or is interrupted.

    - input 0 ``bend_angle``: φ (S), rad
    - output 0 ``bend_angle``: φ (S), rad, some periods later; while it is absent NaN, or the
      last reading
    - state, discrete: readings on their way (L S), the oldest first, and the last one that
      is not absent (S); updated each `PERIOD`
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        size: int,
        *,
        delay: float = 0.0,
        start: float = 0.0,
        absence: float = 0.0,
        held: bool = False,
    ):
        """
        Args:
            size: S.
            delay: s, in multiples of `PERIOD`.
            start, absence: from when and for how long it is absent, s.
            held: whether the last reading is shown then.
        """
        super().__init__()
        self._start, self._end, self._held = start, start + absence, held
        self._num_late, self._size = round(delay / PERIOD), size
        self.DeclareVectorInputPort("bend_angle", size)
        self.DeclareDiscreteState((self._num_late + 1) * size)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._fill))
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))
        self.DeclareVectorOutputPort("bend_angle", size, weak_method(self._calc))
        self.set_name("bend_path")

    def _is_absent(self, context) -> bool:
        return self._start <= context.get_time() < self._end

    def _fill(self, context, discrete_state):
        reading = self.get_input_port().Eval(context)
        discrete_state.set_value(np.tile(reading, self._num_late + 1))

    def _update(self, context, discrete_state):
        on_the_way, last = self._readings(context)
        if not self._is_absent(context):
            last = on_the_way[0]
        discrete_state.set_value(np.concatenate([*on_the_way[1:], last]))

    def _readings(self, context) -> tuple[np.ndarray, np.ndarray]:
        """Those on their way and now (L + 1, S), and the last one (S,)."""
        kept = context.get_discrete_state_vector().value().reshape(-1, self._size)
        return np.vstack([kept[:-1], self.get_input_port().Eval(context)]), kept[-1]

    def _calc(self, context, output):
        on_the_way, last = self._readings(context)
        shown = on_the_way[0]
        if self._is_absent(context):
            shown = last if self._held else np.full(self._size, np.nan)
        output.SetFromVector(shown)


def behind_bend_path(controller: System, **changes: Any) -> Diagram:
    """A controller with the same ports, which the bend reaches by a `BendPath`.

    Args:
        controller: with the input ``bend_angle`` and the output ``duty``.
        changes: as for `BendPath`.
    """
    path = BendPath(controller.GetInputPort("bend_angle").size(), **changes)
    return behind(path, controller, "behind_bend_path")

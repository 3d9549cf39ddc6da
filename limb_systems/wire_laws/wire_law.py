"""How a wire heats, pulls and is measured: the one place where a wire's law is stated.

Drake's blocks, the planner's constraints and their derivatives, its
quasi-static start, the calibration's simulation and the temperature limits
all follow from the methods of a `WireLaw`. A new law needs one new subclass;
``parameters.segments[0].wires[0].law = MyLaw()`` uses it.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.schema import Tagged, quantity

TEMPERATURE_SCALE = 50.0  # °C, a typical change


class WireLaw(Tagged):
    """A shape-memory-alloy wire with its thermocouple; subclasses are dataclasses.

    A law is written for one wire and evaluated for many at once: each state x,
    the duty D in [0, 1] and the angle θ in rad by which a link turns towards the wire may be
    numbers, arrays of floats, AutoDiffXd, or symbols of Drake or CasADi. The law's own fields that
    are numbers may be arrays, too. The methods must therefore work element by element, with
    arithmetic and numpy's functions (`numpy.exp`, `numpy.tanh`, ...), without branches, and be
    smooth. A limb calls them once with symbols, which CasADi differentiates, and evaluates the
    code of the result.

    - ``states``: names of the wire's states, the wire temperature ``T``, °C,
      first. The value of each is a typical change, by which solvers scale it.
    - ``memory``: names of states that stay where T does, and so keep what happened to the
      wire, each with the least and the largest value that it can have.
    - ``below``: names of fields that are less than another field in every wire, each with the
      name of that other.
    """

    states: ClassVar[dict[str, float]] = {"T": TEMPERATURE_SCALE}
    memory: ClassVar[dict[str, tuple[float, float]]] = {}
    below: ClassVar[dict[str, str]] = {}

    @classmethod
    def is_temperature(cls, state: str) -> bool:
        """Whether a state is a temperature, °C: its typical change is 10 or more."""
        return cls.states[state] >= 10.0

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Time derivatives of the states, in the order of ``states``, per second."""
        raise NotImplementedError

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Torque of a wire towards its own side on a link that turns towards it by θ, N·m."""
        raise NotImplementedError

    def reading_rate(self, V: Any, x: Sequence[Any] | np.ndarray) -> Any:
        """Time derivative of the temperature V that the thermocouple reads, °C/s."""
        raise NotImplementedError

    def cold_states(self, T0: float) -> Sequence[float]:
        """The states of a wire that was never heated, at ambient temperature T0."""
        return [T0] * len(self.states)

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """The states of a wire that was heated from cold to T.

        Those that change while T is held are settled later; what counts here
        are those that do not, such as a memory.
        """
        return [T, *self.cold_states(T0)[1:]]

    def easier(self) -> "WireLaw":
        """Return a similar law that is easier to plan with, or this law if there is none.

        A plan with this law starts from the plan with the easier one.
        """
        return self

    def typical_rates(self) -> dict[str, float]:
        """The rates of eqns (6) and (7) that come closest to the wire's.

        A board bounds the wire's heat around them, and emulated limbs are drawn
        around them.

        Returns:
            ``fastest_cooling`` and ``slowest_cooling``, -a1 of heat that has just
            begun and of heat that lasts, 1/s; ``heating``, a2, °C/s; ``reading``,
            -a3, 1/s.

        Raises:
            LimbError: if the law does not say.
        """
        raise LimbError(
            f"{type(self).__name__} does not say how fast its wire heats and cools; add the method "
            "typical_rates to it, or, if it is for a board only, heat_bounds to the wire."
        )


@dataclasses.dataclass
class LinearLaw(WireLaw):
    """The paper's law: linear heat, linear lag, and torque proportional to temperature.

    - ``a1``: cooling rate towards ambient, 1/s, negative (6).
    - ``a2``: heating rate at full duty, °C/s (6).
    - ``a3``: rate of the measurement lag, 1/s, negative (7).
    - ``beta``: joint torque per degree above ambient, N·m/°C (4). The length
      of the wire's lever is included.
    """

    a1: float = quantity(-0.07, "1/s", -10.0, -1e-4)
    a2: float = quantity(20.0, "°C/s", 0.1, 1000.0)
    a3: float = quantity(-1.0, "1/s", -100.0, -1e-3)
    beta: float = quantity(4.7e-4, "N·m/°C", 1e-8, 1.0)

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """β (T - T0), eqn (4)."""
        return self.beta * (x[0] - T0)

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Ṫ = a1 (T - T0) + a2 D, eqn (6)."""
        return [self.a1 * (x[0] - T0) + self.a2 * D]

    def reading_rate(self, V: Any, x: Sequence[Any] | np.ndarray) -> Any:
        """V̇ = a3 (V - T), eqn (7)."""
        return self.a3 * (V - x[0])

    def typical_rates(self) -> dict[str, float]:
        """Rates -a1, a2 and -a3 of the law."""
        cooling = {"slowest_cooling": -self.a1, "fastest_cooling": -self.a1}
        return {**cooling, "heating": self.a2, "reading": -self.a3}


def runge_kutta(
    rates: Callable[[Any, Any], Any], states: Any, duty: Sequence[Any], step: Any
) -> Any:
    """States after a step, by the classical Runge-Kutta method.

    Args:
        rates: function of states and duty, of arrays or symbols.
        duty: duty at the beginning, in the middle and at the end of the step.
        step: s.
    """
    before, middle, after = duty
    first = rates(states, before)
    second = rates(states + step / 2 * first, middle)
    third = rates(states + step / 2 * second, middle)
    fourth = rates(states + step * third, after)
    return states + step / 6 * (first + 2 * (second + third) + fourth)

"""The base of the wire laws: heat, torque and reading of a wire, stated in one place.

Drake's blocks, the planner's constraints and their derivatives, its
quasi-static start, the calibration's simulation and the temperature limits
all follow from the methods of a `WireLaw`. A new law needs one new subclass;
``parameters.segments[0].wires[0].law = MyLaw()`` uses it.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from limb_systems.errors import LimbError
from limb_systems.files.schema import Tagged

TEMPERATURE_SCALE = 50.0  # °C, a typical change
# Kinds of recordings, for `Prior.identified_by`.
COLD_HEATING = "heating of a cold wire"
SLOW_HEATING = "slow heating and cooling"


class Prior(NamedTuple):
    """The distribution of a field in published recordings of this family of limbs and data sheets.

    - ``center``: expected value; of a field that is `WireLaw.below` another, their difference.
    - ``spread``: standard deviation of limbs about it, of the logarithm, or of the value for
      temperatures and for fields that may be zero.
    - ``wire_spread``: standard deviation of the wires of one limb about their mean, of the
      logarithm or of the value as for ``spread``.
    - ``identified_by``: kind of the recording that identifies it best; empty if none does.
    """

    center: float
    spread: float
    wire_spread: float
    identified_by: str = ""


# Of fields that several laws have.
COOLING = Prior(-0.1, 0.8, 0.2, COLD_HEATING)  # 1/s
HEATING = Prior(40.0, 0.8, 0.2, COLD_HEATING)  # °C/s
LAG = Prior(-0.6, 0.8, 0.5, COLD_HEATING)  # 1/s; a thermocouple may be badly bonded
TORQUE_RATE = Prior(6e-4, 1.0, 0.2, SLOW_HEATING)  # N·m/°C
FULL_TORQUE = Prior(0.04, 0.7, 0.2, SLOW_HEATING)  # N·m
MIDDLE = Prior(70.0, 12.0, 4.0, SLOW_HEATING)  # °C
WIDTH = Prior(9.0, 0.4, 0.15, SLOW_HEATING)  # °C


class WireLaw(Tagged):
    """A shape-memory-alloy wire with its thermocouple; subclasses are dataclasses.

    A law is written for one wire and evaluated for many at once: each state x,
    the duty D in [0, 1] and the angle θ in rad by which a link turns towards the wire may be
    numbers, arrays of floats, AutoDiffXd, or symbols of Drake or CasADi. The law's own fields that
    are numbers may be arrays, too. The methods must therefore work element by element, with
    arithmetic and numpy's functions (`numpy.exp`, `numpy.tanh`, ...), without branches, and be
    smooth. A limb calls them once with symbols, which CasADi differentiates, and evaluates the
    code of the result.

    The metadata of a field have its unit and range, see `quantity`; its ``meaning``, which the
    documentation of the class lists; and its `Prior`, from which calibration starts.

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

    def __init_subclass__(cls, **options: Any):
        super().__init_subclass__(**options)
        # List the fields in the documentation, of bases, too.
        fields: dict[str, Any] = {}
        for base in reversed(cls.__mro__):
            fields |= getattr(base, "__dataclass_fields__", {})
        for name, value in vars(cls).items():
            if isinstance(value, dataclasses.Field):
                fields[name] = value
        # Add a line for each field that has a meaning.
        lines = []
        for name, field in fields.items():
            if meaning := field.metadata.get("meaning"):
                unit = field.metadata["unit"]
                lines.append(f"    - ``{name}``: {meaning}{f', {unit}' if unit != '1' else ''}.")
        if lines:
            cls.__doc__ = (cls.__doc__ or "").rstrip() + "\n\n" + "\n".join(lines) + "\n"

    @classmethod
    def is_temperature(cls, state: str) -> bool:
        """Return whether a state is a temperature, °C: its typical change is 10 or more."""
        return cls.states[state] >= 10.0

    def rates(self, x: Sequence[Any] | np.ndarray, D: Any, T0: Any) -> Sequence[Any]:
        """Return time derivatives of the states, in the order of ``states``, per second.

        They are affine in the duty D, as the heat of PWM is.
        """
        raise NotImplementedError

    def torque(self, x: Sequence[Any] | np.ndarray, T0: Any, theta: Any) -> Any:
        """Return a wire's torque, N·m, towards its side on a link that turns towards it by θ."""
        raise NotImplementedError

    def reading_rate(self, V: Any, x: Sequence[Any] | np.ndarray) -> Any:
        """Return the time derivative of the temperature V that the thermocouple reads, °C/s."""
        raise NotImplementedError

    def cold_states(self, T0: float) -> Sequence[float]:
        """Return the states of a wire that was never heated, at ambient temperature T0."""
        return [T0] * len(self.states)

    def warm_states(self, T: Any, T0: float) -> Sequence[Any]:
        """Return the states of a wire that was heated from cold to T.

        States that change while T is held are settled later. Only the other states matter
        here, such as a memory.
        """
        return [T, *self.cold_states(T0)[1:]]

    def smoothed(self) -> "WireLaw":
        """Return a similar law that is easier to plan with, or this law if there is none.

        A plan with this law starts from the plan with the smoothed law.
        """
        return self

    def typical_rates(self) -> dict[str, float]:
        """Return the rates of eqns (6) and (7) that come closest to the wire's.

        A board bounds the wire's heat around them, and emulated limbs are drawn
        around them.

        Returns:
            ``fastest_cooling`` and ``slowest_cooling``, -a1 of heat that has just
            begun and of heat that lasts, 1/s; ``heating``, a2, °C/s; ``reading``,
            -a3, 1/s.

        Raises:
            LimbError: if the law does not define them.
        """
        raise LimbError(
            f"{type(self).__name__} does not say how fast its wire heats and cools; add the method "
            "typical_rates to it, or, if it is for a board only, heat_bounds to the wire."
        )


def runge_kutta(
    rates: Callable[[Any, Any], Any], states: Any, duty: Sequence[Any], step: Any
) -> Any:
    """Return the states after a step of the classical Runge-Kutta method.

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


def duty_for_rate(rate: Any, rate_off: Any, rate_on: Any) -> Any:
    """Return the duty that gives a rate; rates are affine in it, from off to on."""
    return (rate - rate_off) / (rate_on - rate_off)


def logistic(z: Any) -> Any:
    """Return 1 / (1 + exp(-z))."""
    return 0.5 * (1.0 + np.tanh(0.5 * z))


def softplus(z: Any) -> Any:
    """Return ln(1 + exp(z)), also where exp(z) is too large for a number."""
    size = np.sqrt(z**2 + 1e-12)  # |z|, whose derivative all scalar types have at 0
    return 0.5 * (z + size) + np.log(1.0 + np.exp(-size))

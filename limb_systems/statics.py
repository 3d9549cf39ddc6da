"""Static equilibria of a limb, and how they move with the wires' temperature."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.errors import LimbError
from limb_systems.limb_model import LimbModel
from limb_systems.limb_parameters import LimbParameters


def static_equilibrium(
    parameters: LimbParameters | LimbModel, wire_temperature: ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint angles at rest, and their compliance to generalized forces.

    Args:
        wire_temperature: T (W,), °C, held until the limb has settled; ambient if None.

    Returns:
        θ (n,), rad, and the compliance ∂θ/∂f (n, n), rad/(N·m).

    Raises:
        LimbError: if Newton's method finds no stable equilibrium, for example
            because gravity folds the limb.
    """
    model = LimbModel.of(parameters)
    ambient = np.full(model.layout.num_wires, model.parameters.ambient_temperature)
    wire = ambient if wire_temperature is None else np.asarray(wire_temperature, float)
    if wire.shape != ambient.shape or not np.isfinite(wire).all():
        raise LimbError(
            f"wire_temperature is {wire.tolist()}; it must be {ambient.size} finite numbers, "
            "one for each wire."
        )
    return model.statics.at_rest(wire)


def resting_state(parameters: LimbParameters | LimbModel, readings: ArrayLike) -> np.ndarray:
    """Return the state [θ, θ̇, x, V] of a `Limb` at rest, some minutes after its last heat.

    Its silicone is as warm as its wires: it cools so slowly that they follow it.

    Args:
        readings: V (W,), °C, one number for all wires, or NaN where there is no thermocouple,
            which stands for ambient temperature.

    Raises:
        LimbError: if there is not a reading for each wire, or one is infinite.
    """
    V = np.asarray(readings, float)
    model = LimbModel.of(parameters)
    count = model.layout.num_wires
    ambient = model.parameters.ambient_temperature
    if V.shape not in ((), (1,), (count,)) or np.isinf(V).any():
        raise LimbError(
            f"The readings at the start are {V.tolist()}; give °C, one number or one for each of "
            f"{count} wires."
        )
    # Wires without a thermocouple are at ambient temperature.
    V = np.broadcast_to(np.where(np.isnan(V), ambient, V), count)
    return model.statics.resting_state(V)


def mean_bend_by_temperature(
    parameters: LimbParameters | LimbModel, bend: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return the mean slope of each bend by each wire's T (F, W), rad/°C, from T_warm to T_max.

    One wire warms at a time, the others stay at T_warm. The slope is zero for the wires of other
    segments, although their bends change the load by gravity.

    Args:
        bend: function of T (W,), °C, that gives the bend angles at rest (F,), rad.
    """
    model = LimbModel.of(parameters)
    layout = model.layout
    limits = model.parameters.temperature_limits
    num_wires = layout.num_wires
    rise = limits.maximum - limits.warm
    warm_bend = bend(np.full(num_wires, limits.warm))
    # Warm one wire at a time.
    slopes = np.zeros((layout.num_bends, num_wires))
    for wire in range(num_wires):
        temperature = np.full(num_wires, limits.warm)
        temperature[wire] += rise
        slopes[:, wire] = (bend(temperature) - warm_bend) / rise
    # Keep the slopes by the wires of the bend's own segment.
    for bend_index, segment in enumerate(layout.bend_segment):
        wires = layout.wires_of[segment]
        slopes[bend_index, : wires.start] = 0.0
        slopes[bend_index, wires.stop :] = 0.0
    return slopes

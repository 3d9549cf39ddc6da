"""How fast full duty of each wire bends a limb."""

import numpy as np

from controllers.plan_controller import SampledPlan
from controllers.reduced_model import PERIOD, ReducedModel

LEAST_GAIN = 0.25  # of the mean gain, that a cold wire is taken to have at least


def mean_gains(model: ReducedModel) -> np.ndarray:
    """g (S, W), rad/s: the bend rate by full duty, on average from T_warm to T_max.

    Zero for the wires of other segments, by whose bend gravity bends a segment, too.
    """
    limits, W = model.parameters.temperature_limits, model.num_wires
    warm = np.full(W, limits.warm)
    bend = model.bend_angle(model.heated(warm))
    slopes = []
    for wire in range(W):
        hot = warm.copy()
        hot[wire] = limits.maximum
        slopes.append((model.bend_angle(model.heated(hot)) - bend) / (limits.maximum - limits.warm))
    return np.transpose(slopes) * model.heating_rates * np.abs(np.sign(model.sides))


def planned_gains(model: ReducedModel, plan: SampledPlan) -> np.ndarray:
    """g (K, S, W), rad/s: the bend rate by full duty along a plan, from a quarter of the mean up.

    It is not more than the mean, as a wire that transforms now may not do so later.
    """
    mean = mean_gains(model)
    by_duty = model.bend_slopes(plan.heat)[1] @ model.linearized_step(plan.heat, plan.duty)[2]
    towards = by_duty / PERIOD * np.sign(mean)
    return np.sign(mean) * np.clip(towards, LEAST_GAIN * np.abs(mean), np.abs(mean))

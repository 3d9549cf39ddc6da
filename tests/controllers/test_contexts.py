"""All that a controller knows is in its Context, and it does not need readings to go on."""

import dataclasses

import numpy as np

from controllers import (
    LimbObserver,
    PlanFeedback,
    PlanRegulator,
    RecedingHorizon,
    TemperatureSupervisor,
    supervised,
)


def cooler(parameters, limit):
    """A limb whose board cuts out 5 °C above a limit."""
    limits = dataclasses.replace(parameters.temperature_limits, measured_maximum=limit + 5.0)
    return dataclasses.replace(parameters, temperature_limits=limits)


CONTROLLERS = {
    "LimbObserver": lambda plan: LimbObserver(plan.parameters),
    "TemperatureSupervisor": lambda plan: TemperatureSupervisor(cooler(plan.parameters, 45.0)),
    "PlanFeedback": PlanFeedback,
    "PlanRegulator": PlanRegulator,
    "RecedingHorizon": RecedingHorizon,
    "supervised": lambda plan: supervised(PlanFeedback(plan), cooler(plan.parameters, 60.0)),
}


def course(controller, ticks):
    """Readings, and duty if it takes any, of a limb that warms and swings (K, size)."""
    times, rng = 0.05 * np.arange(ticks)[:, None], np.random.default_rng(7)
    inputs = {
        "measured_temperature": 25.0 + [4.0, 9.0] * times + rng.normal(0.0, 0.2, (ticks, 2)),
        "bend_angle": np.deg2rad(4.0 * times + rng.normal(0.0, 0.3, (ticks, 1))),
        "duty": np.clip(0.5 + [0.3, -0.2] * np.sin(times), 0.0, 1.0),
    }
    return {name: rows for name, rows in inputs.items() if controller.HasInputPort(name)}


def part(inputs, rows):
    return {name: values[rows] for name, values in inputs.items()}


def assert_alike(one, other):
    for name, values in vars(one).items():
        if name != "context":
            np.testing.assert_array_equal(values, getattr(other, name), name)


def test_a_copy_of_the_context_continues_identically(fed, short_plan):
    """In the same system, though that went on meanwhile, and in one that is made anew."""
    for make in CONTROLLERS.values():
        controller = make(short_plan)
        inputs = course(controller, 22)
        early, late = part(inputs, slice(17)), part(inputs, slice(17, None))
        middle = fed(controller, early).context
        at_once = fed(controller, late, middle.Clone())
        assert np.ptp(next(iter(vars(at_once).values())), axis=0).max() > 0.0
        assert_alike(at_once, fed(controller, late, middle.Clone()))

        another = make(short_plan)
        context = another.CreateDefaultContext()
        context.SetTime(middle.get_time())
        for index in range(middle.num_discrete_state_groups()):
            context.SetDiscreteState(index, middle.get_discrete_state(index).value())
        assert_alike(at_once, fed(another, late, context))

        beginning = fed(another, late).context.get_discrete_state(0).value()
        assert not np.array_equal(beginning, at_once.context.get_discrete_state(0).value())


def test_controllers_go_on_without_readings(fed, short_plan):
    """NaN from all sensors, from the beginning and after a while; duty stays in [0, 1]."""
    for name, make in CONTROLLERS.items():
        for first in (0, 15):
            controller = make(short_plan)
            inputs = course(controller, 22)
            for port in inputs.keys() - {"duty"}:
                inputs[port][first:] = np.nan
            shown = fed(controller, inputs)
            outputs = vars(shown).keys() & {"duty", "wire_temperature"}
            assert all(np.isfinite(getattr(shown, output)).all() for output in outputs), name
            if "duty" in outputs:
                assert ((shown.duty >= 0.0) & (shown.duty <= 1.0)).all()

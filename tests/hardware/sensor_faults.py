"""Sensors that lie for a while, between a limb and its controller."""

import dataclasses
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Diagram, LeafSystem, System

from limb_systems.drake_python import weak_method
from limb_systems.limb_system import behind
from limb_systems.simulation import PERIOD


@dataclasses.dataclass(frozen=True)
class SensorFault:
    """What one sensor shows for a while.

    - ``sensor``: its number, thermocouples first.
    - ``shown``: function of the time since the fault came, s, of the reading, of that
      before the fault, and of a number that is normal and new each period.
    - ``start``, ``end``: s.
    """

    sensor: int
    shown: Callable[[float, float, float, float], float]
    start: float
    end: float = np.inf


class FaultySensors(LeafSystem):
    """Passes the readings of W thermocouples and S bend sensors on, one of them with a fault.

    - input 0 ``measured_temperature``: V (W), °C
    - input 1 ``bend_angle``: φ (S), rad
    - output 0 ``measured_temperature``: V (W), °C, or NaN
    - output 1 ``bend_angle``: φ (S), rad, or NaN
    - state, discrete, at 20 Hz: the last reading without the fault, its random number
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, num_wires: int, num_segments: int, fault: SensorFault):
        """
        Args:
            num_wires, num_segments: W and S.
            fault: of one of them.
        """
        super().__init__()
        self._fault, self._random = fault, np.random.default_rng(0)
        state = self.DeclareDiscreteState(2)
        first = 0
        for name, size in (("measured_temperature", num_wires), ("bend_angle", num_segments)):
            port = self.DeclareVectorInputPort(name, size)
            self.DeclareVectorOutputPort(
                name,
                size,
                self._passed_on(port, fault.sensor - first),
                {self.discrete_state_ticket(state), self.time_ticket(), port.ticket()},
            )
            first += size
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, weak_method(self._update))

    def _update(self, context, state) -> None:
        held = context.get_discrete_state_vector()[0]
        if context.get_time() < self._fault.start:
            readings = [self.get_input_port(index).Eval(context) for index in range(2)]
            held = np.concatenate(readings)[self._fault.sensor]
        state.set_value([held, self._random.normal()])

    def _passed_on(self, port, index: int) -> Callable:
        fault = self._fault

        def calc(context, output) -> None:
            readings, time = port.Eval(context).copy(), context.get_time()
            if 0 <= index < len(readings) and fault.start <= time < fault.end:
                held, noise = context.get_discrete_state_vector().value()
                readings[index] = fault.shown(time - fault.start, readings[index], held, noise)
            output.SetFromVector(readings)

        return calc


def with_faulty_sensors(controller: System, fault: SensorFault) -> Diagram:
    """A controller whose readings have a fault, with the controller's ports.

    Args:
        controller: with the inputs ``measured_temperature`` and ``bend_angle`` and the
            output ``duty``; it becomes part of the diagram.
    """
    names = ("measured_temperature", "bend_angle")
    num_wires, num_segments = (controller.GetInputPort(name).size() for name in names)
    sensors = FaultySensors(num_wires, num_segments, fault)
    return behind(sensors, controller)

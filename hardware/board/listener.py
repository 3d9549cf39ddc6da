"""A system that hands the signals of a running limb to a function, for journals and live pages."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort

from limb_systems import LimbSystem, Recording
from limb_systems.drake_python import weak_method

Signals = dict[str, np.ndarray]


class SignalListener(LeafSystem):
    """A system that hands signals to a function at a rate.

    - an input for each signal, by its name, such as ``duty`` (W), in [0, 1]
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self, sizes: Mapping[str, int], rate: float, take: Callable[[float, Signals], None]
    ):
        """
        Args:
            sizes: sizes of the inputs, by their names.
            rate: Hz.
            take: function of the time, s, and the signals by name.
        """
        super().__init__()
        self._take = take
        for name, size in sizes.items():
            self.DeclareVectorInputPort(name, size)
        self.DeclarePeriodicPublishEvent(1 / rate, 0.0, weak_method(self._publish))

    def _publish(self, context) -> None:
        signals = {}
        for index in range(self.num_input_ports()):
            port = self.get_input_port(index)
            signals[port.get_name()] = port.Eval(context)
        self._take(context.get_time(), signals)


def ports_of_run(
    limb: LimbSystem, duty: OutputPort, optional: Sequence[str], reference: OutputPort | None
) -> dict[str, OutputPort]:
    """Return the ports of a run by the names of their signals: duty, readings, others, reference.

    Args:
        duty: port that drives the limb.
        optional: further outputs of the limb, of which it may lack some.
        reference: port of the reference of the bend angles, if there is one.
    """
    ports = {"duty": duty}
    for name in (*Recording.MEASURED, *filter(limb.HasOutputPort, optional)):
        ports[name] = limb.GetOutputPort(name)
    if reference:
        ports["reference"] = reference
    return ports


def listen(
    builder: DiagramBuilder,
    ports: Mapping[str, OutputPort],
    rate: float,
    take: Callable[[float, Signals], None],
) -> None:
    """Add a `SignalListener` to a diagram, and connect it to ports by the names of its inputs."""
    sizes = {name: port.size() for name, port in ports.items()}
    listener = builder.AddSystem(SignalListener(sizes, rate, take))
    for name, port in ports.items():
        builder.Connect(port, listener.GetInputPort(name))

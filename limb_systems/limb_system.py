"""Systems that are used by the names of their ports: limbs, their stand-ins, and controllers."""

from typing import Protocol

from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    System,
)

from limb_systems.errors import LimbError
from limb_systems.files.schema import check_text
from limb_systems.limb_parameters import LimbParameters

ACCURACY = 1e-3  # of simulations, where a system does not say otherwise


class LimbSystem(Protocol):
    """Any Drake system with the ports of a limb and these attributes.

    For a limb of F bends and W wires it has the input port ``duty`` (W)
    and the output ports ``measured_temperature`` (W), °C, and ``bend_angle``
    (F), rad. It may have other ports.

    - ``parameters``: description of the limb, as far as it is known.
    - ``source``: a line of text that names the system in recordings of it.
    - ``real_time``: whether it must run in real time and be closed at the end
      by its method ``close``, as a robot must; False if left out.
    - ``accuracy``: accuracy of the integrator that it needs, an absolute error in
      °C, rad and rad/s; 1e-3 if left out; None if its mechanics is in steps.
    """

    parameters: LimbParameters
    source: str
    real_time: bool
    accuracy: float | None

    # The methods of Drake systems that are used here.
    def HasOutputPort(self, port_name: str) -> bool:
        """Return whether there is an output port of a name."""

    def GetInputPort(self, port_name: str) -> InputPort:
        """Return the input port of a name."""

    def GetOutputPort(self, port_name: str) -> OutputPort:
        """Return the output port of a name."""

    def GetMyContextFromRoot(self, root_context: Context) -> Context:
        """Return the system's own part of the Context of a diagram."""

    def GetMyMutableContextFromRoot(self, root_context: Context) -> Context:
        """Return the same Context, mutable."""


def check_limb(system: System) -> LimbSystem:
    """Check that a system can stand in for a limb, and set attributes that it leaves out.

    Raises:
        LimbError: if ports or attributes are missing, or if the parameters or the source are
            invalid; one sentence names them.
    """
    # Collect the missing ports and attributes.
    missing = []
    if not system.HasInputPort("duty"):
        missing.append("the input port duty")
    for name in ("measured_temperature", "bend_angle"):
        if not system.HasOutputPort(name):
            missing.append(f"the output port {name}")
    for name in ("parameters", "source"):
        if not hasattr(system, name):
            missing.append(f"the attribute {name}")
    if missing:
        raise LimbError(
            f"{type(system).__name__} cannot stand in for a limb: it lacks {', '.join(missing)}."
        )
    # Check the attributes, and set the optional ones.
    check_text(system.source, "source")
    system.parameters.validate()
    for name, value in (("real_time", False), ("accuracy", ACCURACY)):
        if not hasattr(system, name):
            setattr(system, name, value)
    return system


def wrap_controller(part: System, controller: System) -> Diagram:
    """Return a controller with another system between it and a limb, with a controller's ports.

    Output ports of each system are connected to the input ports of the other that have the same
    name. All other inputs are inputs of the diagram. Its output ``duty`` is the part's, or
    the controller's if the part has none.

    Args:
        part: such as a supervisor of duty, or sensors with a fault; it becomes part of the diagram.
        controller: with the output ``duty``; it becomes part of the diagram.
    """
    builder = DiagramBuilder()
    builder.AddSystem(part)
    builder.AddSystem(controller)
    # Connect the inputs of each system to the other system, or export them.
    exported: set[str] = set()
    for sink, source in ((part, controller), (controller, part)):
        for index in range(sink.num_input_ports()):
            port = sink.get_input_port(index)
            name = port.get_name()
            if source.HasOutputPort(name):
                builder.Connect(source.GetOutputPort(name), port)
            elif name in exported:
                builder.ConnectInput(name, port)
            else:
                builder.ExportInput(port, name)
                exported.add(name)
    last = part if part.HasOutputPort("duty") else controller
    builder.ExportOutput(last.GetOutputPort("duty"), "duty")
    return builder.Build()

"""The colours of wires in Drake's own live view of any scene."""

from pydrake.geometry import Meshcat
from pydrake.systems.framework import LeafSystem

from limb_systems.drake_python import weak_method
from limb_systems.limb_parameters import LimbParameters
from limb_systems.views.limb_view import linear_wire_color, wire_paths

PUBLISH_PERIOD = 1 / 32  # s


class WireColors(LeafSystem):
    """A block that colours the wires of a limb in the scene of Drake's MeshcatVisualizer.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(self, parameters: LimbParameters, meshcat: Meshcat, limb: str = "limb"):
        """
        Args:
            parameters: description of the limb.
            meshcat: scene in which `AddDefaultVisualization` shows the limb.
            limb: name of the limb's model instance.
        """
        super().__init__()
        self._parameters = parameters
        self._meshcat = meshcat
        path = limb.replace("::", "/")
        self._paths = wire_paths(parameters, f"illustration/{path}/", path)
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(PUBLISH_PERIOD, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))

    def _publish(self, context) -> None:
        temperature = self.get_input_port().Eval(context)
        colors = linear_wire_color(self._parameters, temperature)
        for paths, color in zip(self._paths, colors, strict=True):
            for path in paths:
                self._meshcat.SetProperty(path, "color", [*color.tolist(), 1.0])

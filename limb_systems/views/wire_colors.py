"""Wires in the colour of their heat, of a limb on anybody's plant in Meshcat."""

from pydrake.geometry import Meshcat
from pydrake.systems.framework import LeafSystem

from limb_systems.model.ownership import weak_method
from limb_systems.model.parameters import LimbParameters
from limb_systems.views.limb_view import color_wires, wire_paths
from limb_systems.views.limb_visualizer import PUBLISH_PERIOD


class WireColors(LeafSystem):
    """Colours the wires of a limb that Drake's MeshcatVisualizer shows.

    - input 0 ``wire_temperature``: T (W), °C
    """

    __slots__ = ()  # see limb_systems.model.ownership

    def __init__(
        self,
        parameters: LimbParameters,
        meshcat: Meshcat,
        limb: str = "limb",
        *,
        prefix: str = "illustration",
    ):
        """
        Args:
            parameters: description of the limb.
            meshcat: scene in which the limb is shown.
            limb: name of the limb's model instance.
            prefix: path of the visualizer in the scene, by default that of
                `AddDefaultVisualization`.
        """
        super().__init__()
        self._parameters, self._meshcat = parameters, meshcat
        path = limb.replace("::", "/")
        self._paths = wire_paths(parameters, f"{prefix}/{path}/", path)
        self.DeclareVectorInputPort("wire_temperature", len(parameters.wires))
        self.DeclarePeriodicPublishEvent(PUBLISH_PERIOD, 0.0, weak_method(self._publish))
        self.DeclareForcedPublishEvent(weak_method(self._publish))
        self.set_name(f"{limb}_wire_colors")

    def _publish(self, context) -> None:
        temperature = self.get_input_port().Eval(context)
        color_wires(self._meshcat, self._paths, self._parameters, temperature)

"""Forces of contact on parts of a plant."""

from collections.abc import Sequence

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import LeafSystem

from limb_systems.drake_python import weak_method

# s, of the mechanics where there is contact. Feet that stick creep by 0.4 mm/s for each N along the
# ground, as SAP rounds Coulomb's law off; with half the step it is half as much.
TIME_STEP = 1e-3
# Drake's default softens contact at the end of chains of light links: the crawler's feet sank
# in twice as far as their stiffness says.
NEAR_RIGID_THRESHOLD = 0.0


class ContactForces(LeafSystem):
    """Contact forces on groups of bodies, from points and surfaces.

    Contact between bodies of one group adds up to zero.

    - input 0 ``contact_results``: abstract, of the plant
    - output 0 ``contact_force``: N, of each group, along the axes of the world
    """

    __slots__ = ()  # see limb_systems.drake_python

    def __init__(
        self,
        plant: MultibodyPlant,
        groups: Sequence[Sequence[BodyIndex]],
        axes: Sequence[int] = (0, 1, 2),
    ):
        """
        Args:
            plant: finalized, registered with a SceneGraph.
            groups: bodies whose forces are added up.
            axes: axes of the world along which forces are output: 0 for x, 1 for y, 2 for z.
        """
        super().__init__()
        self._axes = list(axes)
        self._num_groups = len(groups)
        self._group_of_body: dict[BodyIndex, int] = {}
        # Key by the ids' numbers: the ids themselves would keep the plant alive.
        self._body_of_geometry: dict[int, BodyIndex] = {}
        for group, bodies in enumerate(groups):
            for body in bodies:
                self._group_of_body[body] = group
                for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(body)):
                    self._body_of_geometry[geometry.get_value()] = body
        self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        # Declare the ports.
        size = self._num_groups * len(self._axes)
        self.DeclareVectorOutputPort("contact_force", size, weak_method(self._calc))

    def _calc(self, context, output):
        results = self.get_input_port().Eval(context)
        forces = np.zeros((self._num_groups, 3))

        def add_force(body, force, opposite_body):
            """Add a force on a body, and its reaction on the opposite body."""
            for contact_body, sign in ((body, 1.0), (opposite_body, -1.0)):
                if contact_body in self._group_of_body:
                    forces[self._group_of_body[contact_body]] += sign * force

        # Add the forces at points.
        for index in range(results.num_point_pair_contacts()):
            point = results.point_pair_contact_info(index)
            add_force(point.bodyB_index(), point.contact_force(), point.bodyA_index())
        # Add the forces on hydroelastic surfaces.
        for index in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(index)
            surface = info.contact_surface()
            body_m = self._body_of_geometry.get(surface.id_M().get_value())
            body_n = self._body_of_geometry.get(surface.id_N().get_value())
            add_force(body_m, info.F_Ac_W().translational(), body_n)
        output.SetFromVector(forces[:, self._axes].ravel())

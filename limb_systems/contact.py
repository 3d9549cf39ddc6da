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
    """Forces on groups of bodies from whatever touches them, points and surfaces.

    Contact between bodies of one group adds up to nothing.

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
            axes: axes of the world along which forces are shown: 0 for x and so on.
        """
        super().__init__()
        self._axes, self._num_groups = list(axes), len(groups)
        self._group_of = {body: group for group, bodies in enumerate(groups) for body in bodies}
        # By number: the ids themselves would keep the plant alive.
        self._body_of = {
            geometry.get_value(): body
            for body in self._group_of
            for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(body))
        }
        self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        size = self._num_groups * len(self._axes)
        self.DeclareVectorOutputPort("contact_force", size, weak_method(self._calc))

    def _calc(self, context, output):
        results = self.get_input_port().Eval(context)
        forces = np.zeros((self._num_groups, 3))

        def add(on, force, on_other):
            for body, sign in ((on, 1.0), (on_other, -1.0)):
                if body in self._group_of:
                    forces[self._group_of[body]] += sign * force

        for index in range(results.num_point_pair_contacts()):
            point = results.point_pair_contact_info(index)
            add(point.bodyB_index(), point.contact_force(), point.bodyA_index())
        for index in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(index)
            surface = info.contact_surface()
            on, on_other = (
                self._body_of.get(of.get_value()) for of in (surface.id_M(), surface.id_N())
            )
            add(on, info.F_Ac_W().translational(), on_other)
        output.SetFromVector(forces[:, self._axes].ravel())

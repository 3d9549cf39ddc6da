"""Joints and bodies of a limb: axes, springs, levers of the wires, masses and inertia."""

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.layout import Layout
from limb_systems.limb_parameters import LimbParameters, SegmentParameters
from limb_systems.segment_chain import SegmentChain

ANGLE_SCALE = 0.1  # rad, a typical change of a joint, which solvers scale to one


class LimbMechanics:
    """Joints and bodies of a limb of S segments, n joints, W wires, F bends and B bodies.

    Vectors are in the frames of the straight limb, which are parallel to the base's frame.

    - ``layout``: indices of the wires, joints and bends.
    - ``gravity``: acceleration (3,), m/s².
    - ``chains``, ``bend_sensors``: kinematics, `SegmentChain`, and sensor of each segment (S).

    Joints:

    - ``axes``: unit axis of each joint (n, 3), see `SegmentChain`.
    - ``offsets``: origin of each joint from the origin of the joint before, or the base (n, 3), m.
    - ``end_offset``: tip of each segment from the origin of its last joint (S, 3), m.
    - ``stiffness``, ``damping``: k and σ of each joint (n,), N·m/rad and N·m·s/rad.
    - ``rest_angles``: θ at which the rubber rests with wires that were never heated, by (11) (n,),
      rad.
    - ``levers``: B, direction of each wire's torque on each joint (n, W): its `lever` along the
      joint's bend, zero on twists and on joints of other segments.
    - ``shape``: angles of the joints for a bend of 1 rad that they share equally (n, F), (11).

    Bodies are the links, the part before a segment's first joint, and the payload:

    - ``pieces``: bodies of each segment, base first (S): their names in the models of `urdf`, and
      their lengths, m.
    - ``body_joints``: joint that carries each body (B,), -1 for the base.
    - ``body_masses``, ``body_centres``: kg (B,), and centre of mass from the joint's origin
      (B, 3), m.
    - ``body_moments``: principal moments of inertia about E1, E2 and E3 (B, 3), kg·m², of
      homogeneous boxes. The payload is a point.

    Args:
        parameters: description of the limb.
        layout: its layout.
    """

    def __init__(self, parameters: LimbParameters, layout: Layout):
        segments = parameters.segments
        self.layout = layout
        self.gravity = np.array(parameters.gravity, float)
        self.chains = layout.chains
        self.bend_sensors = [segment.bend_sensor for segment in segments]
        self._set_joints(segments)
        self._set_bodies(segments, parameters.payload)

    def _set_joints(self, segments: list[SegmentParameters]) -> None:
        """Set the springs, the levers and the shape of the joints."""
        layout = self.layout
        # Set the springs and dampers of each segment's joints.
        self.axes = np.concatenate([chain.axes for chain in self.chains])
        self.stiffness = np.zeros(layout.num_joints)
        self.damping = np.zeros(layout.num_joints)
        self.rest_angles = np.zeros(layout.num_joints)
        for segment, chain, joints in zip(segments, self.chains, layout.joints_of, strict=True):
            ratios = np.array([segment.joint_ratios[kind] for kind in chain.kinds])
            self.stiffness[joints] = ratios * segment.stiffness
            self.damping[joints] = ratios * segment.damping
            self.rest_angles[joints] = [segment.joint_rest_angles[kind] for kind in chain.kinds]

        # Set the levers of the wires and the shape of each bend.
        self.levers = np.zeros((layout.num_joints, layout.num_wires))
        self.shape = np.zeros((layout.num_joints, layout.num_bends))
        for bend, joints_of_bend in enumerate(layout.bend_joints):
            number = layout.bend_segment[bend]
            direction = layout.bend_direction[bend]
            levers = [wire.lever[direction] for wire in segments[number].wires]
            self.shape[joints_of_bend, bend] = self.chains[number].equal_angle
            self.levers[joints_of_bend, layout.wires_of[number]] = levers

    def _set_bodies(self, segments: list[SegmentParameters], payload: float) -> None:
        """Set the pieces, the bodies, and the offsets of the joints between them."""
        self.offsets = np.zeros((self.layout.num_joints, 3))
        self.end_offset = np.zeros((len(segments), 3))
        self.pieces: list[list[tuple[str, float]]] = []
        bodies: list[tuple[int, float, float]] = []  # joint, mass and centre along E1
        sizes: list[tuple[float, float, float]] = []  # along E1, E2 and E3, m
        end = 0.0  # of the segment before, along E1 from its last joint
        num_links = 0
        for number, (segment, chain) in enumerate(zip(segments, self.chains, strict=True)):
            joints = self.layout.joints_of[number]
            length = segment.length / segment.links
            mass = segment.mass / segment.links
            pieces: list[tuple[str, float]] = []
            # Add the part before the first joint.
            if chain.first_length:
                pieces.append((f"root_{number + 1}", chain.first_length * length))
                sizes.append((chain.first_length * length, segment.thickness, segment.width))
                bodies.append((joints.start - 1, chain.first_length * mass, end + 0.25 * length))
            # Add the links.
            self.offsets[joints, 0] = length * chain.offsets
            self.offsets[joints.start, 0] += end
            for last, share in zip(chain.last_joints, chain.lengths, strict=True):
                num_links += 1
                pieces.append((f"link_{num_links}", share * length))
                sizes.append((share * length, segment.thickness, segment.width))
                bodies.append((joints.start + last, share * mass, 0.5 * share * length))
            self.pieces.append(pieces)
            end = chain.lengths[-1] * length
            self.end_offset[number, 0] = end
        # Add the payload, a point.
        if payload:
            sizes.append((0.0, 0.0, 0.0))
            bodies.append((self.layout.num_joints - 1, payload, end))

        # Collect the bodies in arrays; homogeneous boxes have moments m (y² + z²) / 12.
        body_joints, masses, centres = zip(*bodies, strict=True)
        self.body_joints = np.array(body_joints)
        self.body_masses = np.array(masses)
        self.body_centres = np.outer(centres, [1.0, 0.0, 0.0])
        squares = np.array(sizes) ** 2
        across = squares.sum(axis=1, keepdims=True) - squares
        self.body_moments = self.body_masses[:, None] * across / 12

    def bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """Return φ (F, ...) of joint angles θ (n, ...), rad, as `limb_systems.bend_angle`."""
        angles = np.asarray(joint_angles)
        bends = [chain.bend_angle(angles[joints]) for chain, joints in self.chains_with_joints]
        return np.concatenate(bends)

    def recorded_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """Return the bends (F, ...) that sensors without errors record of θ (n, ...), rad.

        Such sensors have no gain, offset, noise and drift.
        """
        angles = np.asarray(joint_angles)
        bends = []
        for number, (chain, joints) in enumerate(self.chains_with_joints):
            bends.append(self.bend_sensors[number].exact_bends(chain, angles[joints]))
        return np.concatenate(bends)

    @property
    def chains_with_joints(self) -> list[tuple[SegmentChain, slice]]:
        """The kinematics of each segment, and the slice of its joints (S)."""
        return list(zip(self.chains, self.layout.joints_of, strict=True))

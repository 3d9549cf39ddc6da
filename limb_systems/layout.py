"""The layout of a limb: which wires turn which joints, and which joints make which bend."""

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.limb_parameters import LimbParameters


class Layout:
    """Wires, joints and bends of a limb of S segments, L links, n joints, W wires and F bends.

    A segment has a bend for each of its axes: towards E2, then towards E3. Wires, joints and
    bends are in the order of the segments, base first.

    Names:

    - ``segment_suffixes`` (S), ``bend_suffixes`` (F): such as ``_2`` and ``_2_e3``, with the
      name of a segment that has one in place of its number. A limb of one segment has no number,
      and a bend no axis if its segment has one.

    Places, as slices for each segment:

    - ``wires_of``, ``joints_of``, ``bends_of``: places among all wires, joints and bends (S).
    - ``bend_joints``: indices of the joints that make each bend (F).
    - ``bend_segment``, ``bend_direction``: segment of each bend, and 0 if it is towards E2, 1 if
      towards E3 (F,).
    - ``link_of_joint``: (n,); ``links`` are numbered through all segments.
    - ``last_joints``: last joint of each link (L,), whose frame is the link's.
    - ``pieces``: bodies of each segment, base first (S): their names in the models of `urdf`, and
      their lengths, m.

    Mechanics, in the frames of the straight limb, which are parallel to its base's:

    - ``chains``, ``bend_sensors``: kinematics, `SegmentChain`, and sensor of each segment (S).
    - ``axes``: unit axis of each joint (n, 3), as of `SegmentChain`.
    - ``offsets``: origin of each joint from that of the joint before, or the base (n, 3), m.
    - ``end_offset``: tip of each segment from the origin of its last joint (S, 3), m.
    - ``stiffness``, ``damping``: k and σ of each joint (n,), N·m/rad and N·m·s/rad.
    - ``levers``: B, direction of each wire's torque on each joint (n, W): its `lever` along the
      joint's bend, zero on twists and on joints of other segments.
    - ``shape``: angles of the joints for a bend of one that they make alike (n, F), eqn (11).
    - ``body_joints``: joint that carries each body (B,), -1 for the base. Bodies are the links,
      what is before a segment's first joint, and the payload.
    - ``body_masses``, ``body_centres``: kg (B,), and centre of mass from the joint's origin
      (B, 3), m.
    - ``body_moments``: principal moments of inertia about E1, E2 and E3 (B, 3), kg·m², of
      homogeneous boxes. The payload is a point.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        segments = parameters.segments
        several = len(segments) > 1
        self.segment_suffixes = [
            f"_{segment.name or number}" if segment.name or several else ""
            for number, segment in enumerate(segments, 1)
        ]
        self.chains = [segment.chain for segment in segments]
        self.bend_sensors = [segment.bend_sensor for segment in segments]
        self.joints_of = slices([len(chain.kinds) for chain in self.chains])
        self.wires_of = slices([len(segment.wires) for segment in segments])
        self.bends_of = slices([segment.axes for segment in segments])
        self.num_joints, self.num_wires, self.num_bends = (
            places[-1].stop for places in (self.joints_of, self.wires_of, self.bends_of)
        )
        self.axes = np.concatenate([chain.axes for chain in self.chains])
        self.bend_suffixes: list[str] = []
        self.bend_joints: list[np.ndarray] = []
        self.bend_segment = np.repeat(range(len(segments)), [s.axes for s in segments])
        self.bend_direction = np.concatenate([np.arange(s.axes) for s in segments])
        self.levers = np.zeros((self.num_joints, self.num_wires))
        self.shape = np.zeros((self.num_joints, self.num_bends))
        self.stiffness, self.damping = np.zeros((2, self.num_joints))
        self.offsets = np.zeros((self.num_joints, 3))
        self.end_offset = np.zeros((len(segments), 3))
        self.pieces: list[list[tuple[str, float]]] = []
        links: list[int] = []
        last_joints: list[int] = []
        bodies: list[tuple[int, float, float]] = []
        sizes: list[tuple[float, float, float]] = []  # of the bodies along E1, E2 and E3, m
        end = 0.0  # of the segment before, along E1 from its last joint
        for number, (segment, chain, suffix) in enumerate(
            zip(segments, self.chains, self.segment_suffixes, strict=True)
        ):
            joints, wires = self.joints_of[number], self.wires_of[number]
            ratios = np.array([segment.joint_ratios[kind] for kind in chain.kinds])
            self.stiffness[joints] = ratios * segment.stiffness
            self.damping[joints] = ratios * segment.damping
            for axis, kind in enumerate(["e2", "e3"][: segment.axes]):
                bending = joints.start + np.flatnonzero(np.array(chain.kinds) == kind)
                self.shape[bending, len(self.bend_joints)] = chain.equal_angle
                self.levers[bending, wires] = [wire.lever[axis] for wire in segment.wires]
                self.bend_joints.append(bending)
                self.bend_suffixes.append(suffix if segment.axes == 1 else f"{suffix}_{kind}")
            piece, mass = segment.length / segment.links, segment.mass / segment.links
            pieces: list[tuple[str, float]] = []
            if chain.first_length:
                pieces.append((f"root_{number + 1}", chain.first_length * piece))
                bodies.append((joints.start - 1, chain.first_length * mass, end + 0.25 * piece))
            self.offsets[joints, 0] = piece * chain.offsets
            self.offsets[joints.start, 0] += end
            for first, last, share in zip(
                chain.first_joints, chain.last_joints, chain.lengths, strict=True
            ):
                pieces.append((f"link_{len(last_joints) + 1}", share * piece))
                bodies.append((joints.start + last, share * mass, 0.5 * share * piece))
                links += [len(last_joints)] * int(last - first + 1)
                last_joints.append(joints.start + int(last))
            self.pieces.append(pieces)
            sizes += [(length, segment.thickness, segment.width) for _, length in pieces]
            end = chain.lengths[-1] * piece
            self.end_offset[number, 0] = end
        if parameters.payload:
            sizes.append((0.0, 0.0, 0.0))
            bodies.append((self.num_joints - 1, parameters.payload, end))
        self.link_of_joint, self.last_joints = np.array(links), np.array(last_joints)
        joints_of_bodies, masses, centres = zip(*bodies, strict=True)
        self.body_joints, self.body_masses = np.array(joints_of_bodies), np.array(masses)
        self.body_centres = np.outer(centres, [1.0, 0.0, 0.0])
        squares = np.array(sizes) ** 2
        across = squares.sum(axis=1, keepdims=True) - squares
        self.body_moments = self.body_masses[:, None] * across / 12

    @property
    def is_planar(self) -> bool:
        """Whether all segments bend in the plane of E1 and E2."""
        return all(chain.is_planar for chain in self.chains)

    def bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """φ (F, ...) of joint angles θ (n, ...), rad, as `limb_systems.bend_angle`."""
        angles = np.asarray(joint_angles)
        bends = [
            chain.bend_angle(angles[joints])
            for chain, joints in zip(self.chains, self.joints_of, strict=True)
        ]
        return np.concatenate(bends)

    def recorded_bend_angle(self, joint_angles: ArrayLike) -> np.ndarray:
        """What bend sensors without gain, offset, noise and drift record, as `bend_angle`."""
        angles = np.asarray(joint_angles)
        bends = [
            sensor.exact_bends(chain, angles[joints])
            for sensor, chain, joints in zip(
                self.bend_sensors, self.chains, self.joints_of, strict=True
            )
        ]
        return np.concatenate(bends)

    def distances(self, bends: ArrayLike) -> np.ndarray:
        """How far bends (F, ...) are from zero, of each segment (S, ...): |φ|, or √Σ φ² of two."""
        angles = np.abs(bends)
        return np.array([np.hypot.reduce(angles[of_segment]) for of_segment in self.bends_of])


def slices(sizes: list[int]) -> list[slice]:
    """The places of parts of given sizes, one after the other."""
    ends = np.cumsum(sizes).tolist()
    return [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]

"""The layout of a limb: which wires turn which joints, and which joints make which bend."""

import numpy as np
from numpy.typing import ArrayLike

from limb_systems.limb_parameters import LimbParameters


class Layout:
    """Indices of the wires, joints and bends of a limb.

    A limb has S segments, L links, n joints, W wires and F bends. A segment has a bend for each of
    its axes: towards E2, then towards E3. Wires, joints and bends are in the order of the
    segments, base first.

    - ``num_joints``, ``num_wires``, ``num_bends``: n, W and F.
    - ``chains``: joints of each segment as its kinematics, `SegmentChain` (S).
    - ``wires_of``, ``joints_of``, ``bends_of``: slice of each segment (S) among all wires, joints
      and bends.
    - ``bend_joints``: indices of the joints that make each bend (F).
    - ``bend_segment``, ``bend_direction``: segment of each bend, and 0 if it is towards E2, 1 if
      towards E3 (F,).
    - ``link_of_joint``: link that each joint turns (n,); links are numbered through all segments.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        segments = parameters.segments
        self.chains = [segment.chain for segment in segments]
        # Number the joints, wires and bends through all segments.
        sizes = []
        for segment, chain in zip(segments, self.chains, strict=True):
            sizes.append((len(chain.kinds), len(segment.wires), segment.axes))
        self.joints_of, self.wires_of, self.bends_of = map(slices, np.transpose(sizes))
        self.num_joints = self.joints_of[-1].stop
        self.num_wires = self.wires_of[-1].stop
        self.num_bends = self.bends_of[-1].stop
        self.bend_joints: list[np.ndarray] = []
        bends: list[tuple[int, int]] = []  # segment and direction of each
        links: list[int] = []
        num_links = 0
        for number, (chain, joints) in enumerate(zip(self.chains, self.joints_of, strict=True)):
            # Find the joints of each bend.
            for direction, kind in enumerate(["e2", "e3"][: segments[number].axes]):
                bends.append((number, direction))
                in_segment = np.flatnonzero(np.array(chain.kinds) == kind)
                self.bend_joints.append(joints.start + in_segment)
            # Find the link of each joint.
            for first, last in zip(chain.first_joints, chain.last_joints, strict=True):
                links += [num_links] * int(last - first + 1)
                num_links += 1
        self.bend_segment, self.bend_direction = np.transpose(bends)
        self.link_of_joint = np.array(links)

    @property
    def is_planar(self) -> bool:
        """True if all segments bend in the plane of E1 and E2."""
        return all(chain.is_planar for chain in self.chains)

    def distances(self, bends: ArrayLike) -> np.ndarray:
        """Return the distance of bends (F, ...) from zero for each segment (S, ...).

        It is |φ| of a segment with one bend, and √Σ φ² of a segment with two.
        """
        angles = np.abs(bends)
        return np.array([np.hypot.reduce(angles[of_segment]) for of_segment in self.bends_of])


def slices(sizes: ArrayLike) -> list[slice]:
    """Return the slices of consecutive parts of the given sizes."""
    ends = np.cumsum(sizes)
    return list(map(slice, (ends - sizes).tolist(), ends.tolist()))

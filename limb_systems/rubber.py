"""The rubber of a limb beyond linear springs: it stiffens, and its angle at rest has a memory."""

from typing import Any

import casadi as ca
import numpy as np

from limb_systems.limb_mechanics import LimbMechanics
from limb_systems.limb_parameters import LimbParameters

REST_SCALE = 0.03  # rad, a typical change of the bend angle at rest
RAMP_RATE = 0.01  # rad/s; slower heating changes the memory little


class NonlinearRubber:
    """Stiffening and memory of the rubber of all segments.

        f = -k s (|θ - θ_rest| / θ_45)² (θ - θ_rest) + k 2 r / (n + 1)
        r' = λ Σ_i p(g_i') (±Δ - r),  p(z) = z / (1 + exp(-z / ρ))

    on each joint of a segment, with the stiffening s, θ_45 = 2 (π/4) / (n + 1)
    by (11), and the deviation r of the segment's bend angle at rest, which is a
    state where there is a `RestMemory` of Δ and λ. g_i is the bend angle that
    the torque of wire i alone would hold; + is for wires on the +E2 side. p is
    z where z is far above ρ and 0 far below. A wire counts while it heats, and nothing changes at
    rest. Where a segment bends about two axes, |θ - θ_rest| is the length of both bends of a link,
    each bend has its own r, and ±Δ is along the wire's lever. Twists do not stiffen.

    Its forces and rates are expressions of symbols.

    - ``state_names``: such as ``rest_shift_2``, R.
    - ``remembers``: whether any segment does.
    - ``bend_by_torque``: bend angle that a torque of each wire alone holds (W,), rad/(N·m).

    Args:
        parameters: description of the limb.
        mechanics: its joints.
    """

    def __init__(self, parameters: LimbParameters, mechanics: LimbMechanics):
        layout = mechanics.layout
        num_joints = layout.num_joints
        num_wires = layout.num_wires
        num_shifts = sum(s.axes for s in parameters.segments if s.rest_memory is not None)
        self.state_names: list[str] = []
        self.remembers = num_shifts > 0
        self._rest = mechanics.rest_angles
        self._cubic = np.zeros(num_joints)
        self._force_by_shift = np.zeros((num_joints, num_shifts))
        self.bend_by_torque = np.zeros(num_wires)
        self._pace, self._towards = np.zeros((2, num_shifts, num_wires))
        for bend, (joints, suffix) in enumerate(
            zip(layout.bend_joints, parameters.bend_suffixes, strict=True)
        ):
            number = layout.bend_segment[bend]
            segment, wires = parameters.segments[number], layout.wires_of[number]
            equal = mechanics.chains[number].equal_angle
            at_45 = equal * (np.pi / 4)
            self._cubic[joints] = segment.stiffness * segment.stiffening / at_45**2
            memory, row = segment.rest_memory, len(self.state_names)
            if memory is None:
                continue
            self.state_names.append(f"rest_shift{suffix}")
            lever = mechanics.levers[joints[0], wires]
            torque_by_bend = mechanics.stiffness[joints] * equal
            self._force_by_shift[joints, row] = torque_by_bend
            self.bend_by_torque[wires] = np.hypot(
                self.bend_by_torque[wires], lever / torque_by_bend[0]
            )
            self._pace[row, wires] = memory.rate
            # A wire of a planar segment leads to ±Δ, however its lever is inclined.
            share = np.sign(lever) if segment.axes == 1 else lever
            self._towards[row, wires] = memory.rate * memory.shift * share
        bends = np.flatnonzero(mechanics.shape.any(axis=1))
        self._same_link = np.zeros((num_joints, num_joints))
        links = layout.link_of_joint[bends]
        self._same_link[np.ix_(bends, bends)] = links[:, None] == links

    def forces(self, shifts: ca.SX, angles: ca.SX) -> ca.SX:
        """Generalized force (n,), N·m, of r (R,) and θ (n,), rad."""
        bent = angles - ca.DM(self._rest)
        squared = ca.DM(self._same_link) @ bent**2
        force = -ca.DM(self._cubic) * bent * squared
        return force + ca.DM(self._force_by_shift) @ shifts if self.remembers else force

    def rates(self, shifts: ca.SX, torque_rates: ca.SX) -> ca.SX:
        """r' (R,), rad/s, of r (R,) and the rates of all wires' torques (W,), N·m/s."""
        progress = ramp(ca.DM(self.bend_by_torque) * torque_rates)
        return ca.DM(self._towards) @ progress - shifts * (ca.DM(self._pace) @ progress)

    def settled(self, torques: np.ndarray) -> np.ndarray:
        """r (R,) after wires heated from cold, all at once and in proportion, to torques (W,)."""
        bends = np.maximum(self.bend_by_torque * torques, 0.0)
        paths = self._pace @ bends
        gone = np.divide(-np.expm1(-paths), paths, out=np.zeros_like(paths), where=paths > 0)
        return gone * (self._towards @ bends)


def ramp(bend_rate: Any) -> Any:
    """p of a rate, rad/s: about the rate itself if it is positive, about 0 if it is negative."""
    return bend_rate * 0.5 * (1.0 + np.tanh(bend_rate / (2.0 * RAMP_RATE)))

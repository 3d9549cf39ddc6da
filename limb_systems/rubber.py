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
    - ``remembers``: whether the rest angle of any segment has a memory.
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
        self._rate = np.zeros((num_shifts, num_wires))  # λ
        self._rate_times_target = np.zeros((num_shifts, num_wires))  # ± λ Δ
        bends = zip(layout.bend_joints, parameters.bend_suffixes, strict=True)
        for bend, (joints, suffix) in enumerate(bends):
            # Set the stiffening of the joints of this bend.
            number = layout.bend_segment[bend]
            segment = parameters.segments[number]
            wires = layout.wires_of[number]
            equal_angle = mechanics.chains[number].equal_angle
            angle_at_45_deg = equal_angle * (np.pi / 4)
            self._cubic[joints] = segment.stiffness * segment.stiffening / angle_at_45_deg**2
            # Set the memory of this bend.
            memory = segment.rest_memory
            if memory is None:
                continue
            row = len(self.state_names)
            self.state_names.append(f"rest_shift{suffix}")
            lever = mechanics.levers[joints[0], wires]
            torque_by_bend = mechanics.stiffness[joints] * equal_angle
            self._force_by_shift[joints, row] = torque_by_bend
            bend_by_torque = lever / torque_by_bend[0]
            self.bend_by_torque[wires] = np.hypot(self.bend_by_torque[wires], bend_by_torque)
            self._rate[row, wires] = memory.rate
            # A wire of a planar segment leads to ±Δ, however its lever is inclined.
            direction = np.sign(lever) if segment.axes == 1 else lever
            self._rate_times_target[row, wires] = memory.rate * memory.shift * direction
        # Find the pairs of bending joints that turn the same link.
        bending = np.flatnonzero(mechanics.shape.any(axis=1))
        self._same_link = np.zeros((num_joints, num_joints))
        links = layout.link_of_joint[bending]
        self._same_link[np.ix_(bending, bending)] = links[:, None] == links

    def forces(self, shifts: ca.SX, angles: ca.SX) -> ca.SX:
        """Return the generalized force (n,), N·m, of r (R,) and θ (n,), rad."""
        deviation = angles - ca.DM(self._rest)
        squared = ca.DM(self._same_link) @ deviation**2
        force = -ca.DM(self._cubic) * deviation * squared
        return force + ca.DM(self._force_by_shift) @ shifts if self.remembers else force

    def rates(self, shifts: ca.SX, torque_rates: ca.SX) -> ca.SX:
        """Return r' (R,), rad/s, of r (R,) and the rates of all wires' torques (W,), N·m/s."""
        heating = ramp(ca.DM(self.bend_by_torque) * torque_rates)
        return ca.DM(self._rate_times_target) @ heating - shifts * (ca.DM(self._rate) @ heating)

    def settled(self, torques: np.ndarray) -> np.ndarray:
        """Return r (R,) of wires that heated from cold, all at once, to their torques (W,).

        Their torques grew in proportion. r' = λ g' (Δ - r) then has the solution
        Δ (1 - exp(-λ g)) of a single wire.
        """
        # Integrate r' along the bends that grow in proportion.
        bends = np.maximum(self.bend_by_torque * torques, 0.0)
        exponents = self._rate @ bends
        shares = np.divide(
            -np.expm1(-exponents), exponents, out=np.zeros_like(exponents), where=exponents > 0
        )
        return shares * (self._rate_times_target @ bends)


def ramp(bend_rate: Any) -> Any:
    """Return p of a rate, rad/s: near the rate if it is positive, near 0 if it is negative."""
    return bend_rate * 0.5 * (1.0 + np.tanh(bend_rate / (2.0 * RAMP_RATE)))

"""The rubber of a limb beyond linear springs: it stiffens, and its angle at rest has a memory."""

from typing import Any

import numpy as np

from limb_systems.model.kinematics import rest_joint_angles
from limb_systems.model.layout import Layout
from limb_systems.model.parameters import LimbParameters

REST_SCALE = 0.03  # rad, a typical change of the bend angle at rest
RAMP_RATE = 0.01  # rad/s, below which the memory hardly notices that a wire heats


class NonlinearRubber:
    """Stiffening and memory of the rubber of all segments.

        f = -k s (|θ - θ_rest| / θ_45)² (θ - θ_rest) + k 2 r / (n + 1)
        r' = λ Σ_i p(g_i') (±Δ - r),  p(z) = z / (1 + exp(-z / ρ))

    on each joint of a segment, with the stiffening s, θ_45 = 2 (π/4) / (n + 1)
    by (11), and the deviation r of the segment's bend angle at rest, which is a
    state where there is a `RestMemory` of Δ and λ. g_i is the bend angle that
    the torque of wire i alone would hold; + is for wires on the +E2 side. p is
    z where z is far above ρ and 0 far below, and so a wire counts while it
    heats, and nothing changes at rest. Where a segment bends about two axes, |θ - θ_rest| is
    that of both bends of a link, and there is an r for each, towards which ±Δ is along the wire's
    lever. Twists do not stiffen.

    Arrays have the joints, the wires (W) or the states r (R) along their last
    axis, and may be of any scalar type.

    - ``state_names``: such as ``rest_shift_2``, R.
    - ``stiffens``, ``remembers``: whether any segment does.
    - ``force_by_shift``: derivative of the force by r (n, R), N·m/rad.
    - ``bend_by_torque``: bend angle that a torque of each wire alone holds (W,), rad/(N·m).
    - ``pace``: λ of each wire on each shift (R, W), 1/rad.

    Args:
        parameters: description of the limb.
    """

    def __init__(self, parameters: LimbParameters):
        layout = self._layout = Layout(parameters)
        num_joints, num_wires = layout.num_joints, layout.num_wires
        num_shifts = num_rest_shifts(parameters)
        self.state_names: list[str] = []
        self.remembers = num_shifts > 0
        self._rest = rest_joint_angles(parameters)
        self._cubic = np.zeros(num_joints)
        self.force_by_shift = np.zeros((num_joints, num_shifts))
        self.bend_by_torque = np.zeros(num_wires)
        self.pace, self._towards = np.zeros((2, num_shifts, num_wires))
        for bend, (joints, suffix) in enumerate(
            zip(layout.bend_joints, layout.bend_suffixes, strict=True)
        ):
            number = layout.bend_segment[bend]
            segment, wires = parameters.segments[number], layout.wires_of[number]
            equal = layout.chains[number].equal_angle
            at_45 = equal * (np.pi / 4)
            self._cubic[joints] = segment.stiffness * segment.stiffening / at_45**2
            memory, row = segment.rest_memory, len(self.state_names)
            if memory is None:
                continue
            self.state_names.append(f"rest_shift{suffix}")
            lever = layout.levers[joints[0], wires]
            torque_by_bend = layout.stiffness[joints] * equal
            self.force_by_shift[joints, row] = torque_by_bend
            self.bend_by_torque[wires] = np.hypot(
                self.bend_by_torque[wires], lever / torque_by_bend[0]
            )
            self.pace[row, wires] = memory.rate
            # A wire of a planar segment leads to ±Δ, however its lever is inclined.
            share = np.sign(lever) if segment.axes == 1 else lever
            self._towards[row, wires] = memory.rate * memory.shift * share
        self.stiffens = bool(self._cubic.any())
        bends = np.flatnonzero(layout.shape.any(axis=1))
        self._same_link = np.zeros((num_joints, num_joints))
        links = layout.link_of_joint[bends]
        self._same_link[np.ix_(bends, bends)] = links[:, None] == links

    def forces(self, shifts: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Generalized force (..., n), N·m, of r (..., R) and θ (..., n), rad."""
        force = shifts @ self.force_by_shift.T
        if not self.stiffens:
            return force
        bent = angles - self._rest
        if self._layout.is_planar:
            return force - self._cubic * bent**3
        return force - self._cubic * bent * (bent**2 @ self._same_link)

    def force_by_angle(self, angles: np.ndarray) -> np.ndarray:
        """Derivatives of the joints' forces by the angles (..., n, n), N·m/rad."""
        bent = angles - self._rest
        squared = bent**2 @ self._same_link
        own = -(self._cubic * squared)[..., None] * np.eye(len(self._rest))
        products = 2 * bent[..., :, None] * bent[..., None, :] * self._same_link
        return own - self._cubic[:, None] * products

    def force_hessian(self, angles: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Second derivatives of weights · force by the angles (..., n, n), for weights (..., n)."""
        bent, weighted = angles - self._rest, weights * self._cubic
        products = weighted[..., :, None] * bent[..., None, :] * self._same_link
        own = ((weighted * bent) @ self._same_link)[..., None] * np.eye(len(self._rest))
        return -2.0 * (products + products.swapaxes(-1, -2) + own)

    def progress(self, torque_rates: Any, wires: slice | np.ndarray) -> Any:
        """p(g_i') of some wires, rad/s, from the rates of their torques, N·m/s."""
        return ramp(self.bend_by_torque[wires] * torque_rates)

    def rates(self, shifts: np.ndarray, progress: np.ndarray) -> np.ndarray:
        """r' (..., R), rad/s, of r (..., R) and the `progress` of all wires (..., W)."""
        return progress @ self._towards.T - (progress @ self.pace.T) * shifts

    def rates_by_progress(self, shifts: np.ndarray) -> np.ndarray:
        """Derivatives of `rates` by the `progress` of all wires (..., R, W)."""
        return self._towards - self.pace * shifts[..., None]

    def settled(self, torques: np.ndarray) -> np.ndarray:
        """r (R,) after wires heated from cold, all at once and in proportion, to torques (W,)."""
        bends = np.maximum(self.bend_by_torque * torques, 0.0)
        paths = self.pace @ bends
        gone = np.divide(-np.expm1(-paths), paths, out=np.zeros_like(paths), where=paths > 0)
        return gone * (self._towards @ bends)


def ramp(bend_rate: Any) -> Any:
    """p of a rate, rad/s: about the rate itself if it is positive, about 0 if it is negative."""
    return bend_rate * 0.5 * (1.0 + np.tanh(bend_rate / (2.0 * RAMP_RATE)))


def num_rest_shifts(parameters: LimbParameters) -> int:
    """R, the number of bends whose rest angle has a memory."""
    return sum(s.axes for s in parameters.segments if s.rest_memory is not None)

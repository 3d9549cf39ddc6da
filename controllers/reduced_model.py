"""The limb without its swinging: heat in the wires, and the bend that they hold.

The chain swings at some hertz and is damped within a second, the wires heat and
cool within ten. Controllers at 20 Hz therefore see a limb that is always where
its wires' torque and its rubber hold it, θ = K⁻¹ f(x) by (2) and (4).
"""

import numpy as np

from limb_systems import Layout, LimbParameters
from limb_systems.model.statics import HeldAngles
from limb_systems.simulation import PERIOD


class ReducedModel:
    """A limb of S segments and W wires, in steps of constant duty.

    Its state, the heat, is [x, V] (H = N + W): the states of the wires' laws and of
    the rubber's memory, of which the first W are T, °C, and the readings, °C.
    Arrays have any number of points before their last axis.

    - ``num_wires``, ``num_segments``, ``size``: W, S and H.
    - ``cold``: heat of wires that were never heated (H,).
    - ``scales``: typical changes of the heat (H,).
    - ``sides``: direction of each wire's torque in each segment (S, W), zero for wires of
      other segments.
    - ``bend_by_torque``: bend of each segment by a torque on each of its joints (S,),
      rad/(N·m).

    Args:
        parameters: description of the limb.
        period: h of the steps, s.
    """

    def __init__(self, parameters: LimbParameters, period: float = PERIOD):
        self.parameters, self.period = parameters, period
        self._held = HeldAngles(parameters)
        wires = self._wires = self._held.wires
        W = self.num_wires = wires.num_wires
        self.num_segments = len(parameters.segments)
        self.size = wires.num_states + W
        self.cold = np.concatenate([wires.cold_states, wires.cold_states[:W]])
        self.scales = wires.heat_scales
        self._to_bend = np.zeros((self.num_segments, parameters.num_joints))
        self.sides = np.zeros((self.num_segments, W))
        layout = Layout(parameters)
        for index, (segment, joints, around) in enumerate(
            zip(
                parameters.segments,
                layout.joints_of,
                layout.wires_of,
                strict=True,
            )
        ):
            self._to_bend[index, joints] = (segment.links + 1) / (2 * segment.links)  # (11)
            self.sides[index, around] = [wire.lever[0] for wire in segment.wires]
        in_segment = (self._to_bend > 0).T
        self.bend_by_torque = np.diag(self._to_bend @ self._held.compliance @ in_segment).copy()

    @property
    def heating_rates(self) -> np.ndarray:
        """a2 (W,), °C/s: by how much faster cold wires heat at full duty than at none."""
        W = self.num_wires
        full, none = (self.step(self.cold, np.full(W, duty))[:W] for duty in (1.0, 0.0))
        return (full - none) / self.period

    def temperatures(self, heat: np.ndarray) -> np.ndarray:
        """T (..., W), °C."""
        return heat[..., : self.num_wires]

    def readings(self, heat: np.ndarray) -> np.ndarray:
        """V (..., W), °C."""
        return heat[..., -self.num_wires :]

    def heated(self, temperature: np.ndarray) -> np.ndarray:
        """The heat (H,) of cold wires that were heated to T (W,), °C, until they settled."""
        return np.concatenate([self._wires.settled_states(temperature), temperature])

    def step(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """The heat (..., H) a period later, under duty (..., W), by the midpoint method."""
        middle = heat + 0.5 * self.period * self._wires.heat_rates(heat, duty)
        after = heat + self.period * self._wires.heat_rates(middle, duty)
        states = after[..., : self._wires.num_states]
        states[...] = self._wires.within(states)
        return after

    def joint_angles(self, heat: np.ndarray) -> np.ndarray:
        """θ (..., n) that the wires hold, rad."""
        return self._held.angles(heat[..., : -self.num_wires])

    def bend_angle(self, heat: np.ndarray) -> np.ndarray:
        """φ (..., S) that the wires hold, rad, by (11)."""
        return self.joint_angles(heat) @ self._to_bend.T

    def linearized_step(
        self, heat: np.ndarray, duty: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`step` of heat (..., H) and duty (..., W), and its derivatives.

        Returns:
            The heat a period later (..., H), its derivatives by the heat
            (..., H, H) and by duty (..., H, W).
        """
        H, half = self.size, 0.5 * self.period
        rates, by_start = self._wires.expanded_heat_rates(heat, duty)
        rates, by_middle = self._wires.expanded_heat_rates(heat + half * rates, duty)
        slopes = by_middle + half * by_middle[..., :H] @ by_start
        slopes *= self.period
        slopes[..., np.arange(H), np.arange(H)] += 1.0
        after = heat + self.period * rates
        N = self._wires.num_states
        kept = self._wires.within(after[..., :N])
        slopes[..., :N, :][kept != after[..., :N]] = 0.0
        after[..., :N] = kept
        return after, slopes[..., :H], slopes[..., H:]

    def bend_slopes(self, heat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`bend_angle` (..., S), rad, and its derivatives by the heat (..., S, H)."""
        angles, by_state = self._held.expanded(heat[..., : -self.num_wires])
        slopes = np.zeros((*heat.shape[:-1], self.num_segments, self.size))
        slopes[..., : -self.num_wires] = self._to_bend @ by_state
        return angles @ self._to_bend.T, slopes

    def rollout(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """The heat (K + 1, ..., H) from a start (..., H) on, under duty (K, ..., W) of steps."""
        heats = [heat]
        for level in duty:
            heats.append(self.step(heats[-1], level))
        return np.array(heats)

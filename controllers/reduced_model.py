"""The limb without its vibration: heat in the wires, and the bend that they hold.

The chain swings at some hertz and is damped within a second, while the wires heat and
cool within ten seconds. Controllers at 20 Hz therefore assume a limb that is always in the
equilibrium of its wires' torque and its rubber, θ = K⁻¹ f(x) by (2) and (4).
"""

import functools

import casadi as ca
import numpy as np

from limb_systems import LimbModel, LimbParameters
from limb_systems.law_functions import check_affine
from limb_systems.simulation import PERIOD
from limb_systems.smooth_function import SmoothFunction
from limb_systems.statics import mean_bend_by_temperature


class ReducedModel:
    """A limb of F bends and W wires, in steps of constant duty.

    Its state, the heat, is [x, V] (H = N + W): the states of the wires' laws and of
    the rubber's memory, of which the first W are T, °C, and the readings, °C.
    Arrays have any number of points before their last axis.

    - ``limb``: the `LimbModel`.
    - ``num_wires``, ``num_bends``, ``size``: W, F and H.
    - ``cold``: heat of wires that were never heated (H,).
    - ``scales``: typical changes of the heat (H,).
    - ``statics``: the `StaticEquilibria` of the limb.
    - ``symbolic_step``: `step` as a CasADi function.
    - ``bend_by_torque``: each bend by a torque on each of the joints that make it (F,), rad/(N·m).

    Args:
        parameters: the limb or its description.
        period: h of the steps, s.

    Raises:
        LimbError: if the rates of a wire's law are not affine in the duty.
    """

    def __init__(self, parameters: LimbParameters | LimbModel, period: float = PERIOD):
        self.limb = model = LimbModel.of(parameters)
        check_affine(model.parameters)
        self.period = period
        layout = model.layout
        self.statics = model.mean_angle_statics if layout.is_planar else model.statics
        wires = self._wires = self.statics.wires
        W = self.num_wires = wires.num_wires
        self.num_bends = layout.num_bends
        self.size = wires.num_states + W
        self.cold = np.concatenate([wires.cold_states, wires.cold_states[:W]])
        self.scales = wires.heat_scales
        # Each bend by a torque on its joints.
        _, to_bend = self.statics.bends_of_angles.first(self.statics.rest_angles)
        in_bend = model.mechanics.shape > 0
        self.bend_by_torque = np.diag(to_bend @ self.statics.compliance @ in_bend).copy()
        # The step as a function.
        heat = ca.SX.sym("y", self.size)
        duty = ca.SX.sym("D", W)
        after = self._state_step(heat, duty)
        self.symbolic_step = ca.Function("step", [heat, duty], [after])
        self._step = SmoothFunction(after, ca.vertcat(heat, duty))
        self._steps_in_a_row = functools.cache(self.symbolic_step.mapaccum)

    def _state_step(self, heat: ca.SX, duty: ca.SX) -> ca.SX:
        """Return the heat (H,) a period later, by the midpoint method."""

        def rates(heat: ca.SX) -> ca.SX:
            return self._wires.symbolic_heat(heat[:N], heat[N:], duty)

        N = self._wires.num_states
        after = heat + self.period * rates(heat + 0.5 * self.period * rates(heat))
        return ca.vertcat(self._wires.clamp_states(after[:N]), after[N:])

    @functools.cached_property
    def heating_rates(self) -> np.ndarray:
        """The heating rates a2 (W,), °C/s, of cold wires by full duty."""
        W = self.num_wires
        heated = self.step(self.cold, np.ones(W))[:W]
        cooled = self.step(self.cold, np.zeros(W))[:W]
        return (heated - cooled) / self.period

    @functools.cached_property
    def bend_by_temperature(self) -> np.ndarray:
        """`mean_bend_by_temperature` of the limb (F, W), rad/°C."""
        return mean_bend_by_temperature(self.limb, lambda T: self.bend_angle(self.heated(T)))

    @functools.cached_property
    def mean_gains(self) -> np.ndarray:
        """The gains g (F, W), rad/s: bend rates by full duty, on average from T_warm to T_max."""
        return self.bend_by_temperature * self.heating_rates

    def temperature_to_hold(self, offset: np.ndarray) -> np.ndarray:
        """Return the rise of the wires (W,), °C, that holds a bend from outside (F,), rad."""
        from scipy.optimize import nnls  # takes long to import

        return nnls(self.bend_by_temperature, -offset)[0]

    def temperatures(self, heat: np.ndarray) -> np.ndarray:
        """Return T (..., W), °C."""
        return heat[..., : self.num_wires]

    def readings(self, heat: np.ndarray) -> np.ndarray:
        """Return V (..., W), °C."""
        return heat[..., -self.num_wires :]

    def heated(self, temperature: np.ndarray) -> np.ndarray:
        """Return the heat (H,) of wires that were heated from cold to T (W,), °C, and settled."""
        return np.concatenate([self._wires.settled_states(temperature), temperature])

    def rested(self, temperature: np.ndarray) -> np.ndarray:
        """Return the heat (H,) of wires without duty, as warm as their silicone, at V (W,), °C."""
        return np.concatenate([self._wires.rested_states(temperature), temperature])

    def step(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return the heat (..., H) a period later under duty (..., W), by the midpoint method."""
        return self._step.values(np.concatenate([heat, duty], axis=-1))

    def joint_angles(self, heat: np.ndarray) -> np.ndarray:
        """Return θ (..., n), rad, that the wires hold."""
        return self.statics.angles(heat[..., : -self.num_wires])

    def bend_angle(self, heat: np.ndarray) -> np.ndarray:
        """Return φ (..., F), rad, that the wires hold.

        It is the mean of the joints by (11) in a plane, and the chord's bend in space. The observer
        takes the rest of a reading, such as a sagging limb's, for a bend from outside.
        """
        return self.statics.values(heat[..., : -self.num_wires])

    def linearized_step(
        self, heat: np.ndarray, duty: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return `step` of heat (..., H) and duty (..., W), and its derivatives.

        Returns:
            The heat a period later (..., H), its derivatives by the heat
            (..., H, H) and by duty (..., H, W).
        """
        after, slopes = self._step.first(np.concatenate([heat, duty], axis=-1))
        return after, slopes[..., : self.size], slopes[..., self.size :]

    def bend_slopes(self, heat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `bend_angle` (..., F), rad, and its derivatives by the heat (..., F, H)."""
        bend, by_state = self.statics.first(heat[..., : -self.num_wires])
        slopes = np.zeros((*bend.shape, self.size))
        slopes[..., : -self.num_wires] = by_state
        return bend, slopes

    def rollout(self, heat: np.ndarray, duty: np.ndarray) -> np.ndarray:
        """Return the heat (K + 1, ..., H) from a start (..., H) under duty (K, ..., W)."""
        num_steps = len(duty)
        starts = heat.reshape(-1, self.size).T
        # CasADi takes the steps of one rollout after those of another.
        levels = np.moveaxis(duty.reshape(num_steps, -1, self.num_wires), 0, 1)
        steps = self._steps_in_a_row(num_steps)
        after = steps(starts, levels.reshape(-1, self.num_wires).T).full()
        after = after.T.reshape(-1, num_steps, self.size).swapaxes(0, 1)
        return np.concatenate([heat[None], after.reshape(num_steps, *heat.shape)])

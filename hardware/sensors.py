"""Sensors as the robot has them: sampled, noisy, in steps."""

import numpy as np
from pydrake.systems.framework import LeafSystem

from limb_systems.ownership import weak_method


class SampledSensor(LeafSystem):
    """Samples a vector signal and holds it, with noise and quantization.

        y = q round((x + σ w) / q) at every multiple of the period,

    with w standard normal.

    - input 0 ``signal``: x (size)
    - output 0 ``measurement``: y (size), in the unit of the signal
    - state, discrete: y (size), updated each period and at initialization

    The noise comes from a generator that the seed starts and that runs on
    from one simulation to the next, as a sensor's noise does.
    """

    __slots__ = ()  # see limb_systems.ownership

    def __init__(self, size: int, period: float, noise: float, step: float, seed: int):
        """Args:
        size: of the signal.
        period: s between samples.
        noise: standard deviation σ, in the unit of the signal.
        step: quantization q, in the unit of the signal.
        seed: of the noise.
        """
        super().__init__()
        self._noise, self._step = noise, step
        self._generator = np.random.default_rng(seed)
        self.DeclareVectorInputPort("signal", size)
        state = self.DeclareDiscreteState(size)
        self.DeclareInitializationDiscreteUpdateEvent(weak_method(self._sample))
        self.DeclarePeriodicDiscreteUpdateEvent(period, period, weak_method(self._sample))
        self.DeclareStateOutputPort("measurement", state)

    def _sample(self, context, discrete_state):
        signal = self.get_input_port().Eval(context)
        noisy = signal + self._noise * self._generator.standard_normal(len(signal))
        discrete_state.set_value(self._step * np.round(noisy / self._step))

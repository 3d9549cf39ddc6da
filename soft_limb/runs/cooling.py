"""A limb that is shown after its run, while its wires cool."""

import dataclasses
import signal
import warnings

from hardware.board.serial_limb import SerialLimb
from hardware.board.signals import received_signals
from hardware.emulation.twin import LimbTwin
from hardware.live_feed import LiveView, Reading, RunHeader
from hardware.replaying import watch
from limb_systems import LimbError, LimbSystem, Recording

COOL = 3.0  # °C, by which a wire may be warmer than at the start


def cool_down(limb: LimbSystem, recording: Recording, live: LiveView, longest: float) -> None:
    """Shows the limb of a recording, wires off, until they are read as cool as at its start.

    All that the run gives is there by then: Ctrl-C, or the button of the page, ends this and
    nothing else, and what fails is a warning.

    Args:
        limb: limb that was recorded; a model, which keeps no heat, is not shown.
        recording: what is on the page.
        live: the page.
        longest: longest time, s; 0 for none.
    """
    start = recording.measured_temperature[:, recording.usable][:, :1].ravel() + COOL
    if longest <= 0 or not start.size or not isinstance(limb, SerialLimb | LimbTwin):
        return
    try:
        after = (
            SerialLimb(limb.port, limb.parameters, heated=False)
            if isinstance(limb, SerialLimb)
            else limb.after_rest()
        )
        view = _Beyond(live, float(recording.time[-1]))
        watch(after, longest, until=lambda measured: bool((measured <= start).all()), live=view)
    except LimbError as error:
        warnings.warn(f"The wires are not shown while they cool: {error}", stacklevel=2)
    except KeyboardInterrupt:
        if set(received_signals) - {signal.SIGINT}:
            raise
        received_signals.clear()


class _Beyond:
    """A `LiveView` that goes on with the curves of a run."""

    def __init__(self, live: LiveView, start: float):
        self._live, self._start = live, start
        self.say, self.rest = live.say, live.rest

    def begin(self, header: RunHeader) -> None:
        """Nothing: the page has begun."""

    def show(self, reading: Reading) -> None:
        time = self._start + reading.time
        self._live.show(dataclasses.replace(reading, time=time, cooling=True))

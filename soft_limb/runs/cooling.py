"""Show a limb on the live page after its run, while its wires cool."""

import dataclasses
import signal
import warnings

from hardware.board.serial_limb import SerialLimb
from hardware.board.signals import received_signals
from hardware.emulation.twin import LimbTwin
from hardware.live_feed import LiveView, Reading, RunHeader
from hardware.replaying import watch
from limb_systems import LimbError, LimbSystem, Recording

COOL_TOLERANCE = 3.0  # °C; a wire that is warmer than at the start by less is cool


def cool_down(limb: LimbSystem, recording: Recording, live: LiveView, longest: float) -> None:
    """Show a limb after its run, wires off, until its wires are as cool as before the run.

    The results of the run are written before. So Ctrl-C, or the button of the page, ends only
    the cool-down, and a failure of the limb is a warning.

    Args:
        limb: limb that was recorded; a model keeps no heat and is not shown.
        recording: recording of the run on the page.
        live: the page.
        longest: longest time, s; 0 for none.
    """
    limit = recording.measured_temperature[:, recording.usable][:, :1].ravel() + COOL_TOLERANCE
    if longest <= 0 or not limit.size or not isinstance(limb, SerialLimb | LimbTwin):
        return
    # Watch the limb with its wires off.
    try:
        after = (
            SerialLimb(limb.port, limb.parameters, heated=False)
            if isinstance(limb, SerialLimb)
            else limb.after_rest()
        )
        view = _CoolingView(live, float(recording.time[-1]))
        watch(after, longest, until=lambda measured: bool((measured <= limit).all()), live=view)
    except LimbError as error:
        warnings.warn(f"The wires are not shown while they cool: {error}", stacklevel=2)
    except KeyboardInterrupt:
        if set(received_signals) - {signal.SIGINT}:
            raise
        received_signals.clear()


class _CoolingView:
    """A `LiveView` that continues the curves of a run."""

    def __init__(self, live: LiveView, start: float):
        self._live = live
        self._start = start
        self.say = live.say
        self.rest = live.rest

    def begin(self, header: RunHeader) -> None:
        """Do nothing: the page keeps the curves of the run."""

    def show(self, reading: Reading) -> None:
        time = self._start + reading.time
        self._live.show(dataclasses.replace(reading, time=time, cooling=True))

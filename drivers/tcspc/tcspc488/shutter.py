"""The laser shutter that a `tcspc488` drives and reads back."""

from nlos.drivers.errors import DeviceFault, ProtocolError, SafetyTrip
from nlos.drivers.link.scpi import ErrorsReported
from nlos.drivers.shutter import ShutterState
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.messages import safety_error

_MOVES_S = 0.1
_LOOK_S = 0.005


class Tcspc488Shutter:
    """A `LaserShutter` over the counter's own link: `close` goes past whatever that link is doing."""

    on_counter = True

    def __init__(self, counter: Tcspc488) -> None:
        self._instrument = counter.instrument
        self._clock = counter.clock
        self._device = f"{counter.identity.model} shutter"

    def open(self) -> None:
        if self.state().interlock_closed is False:
            raise SafetyTrip(self._device, "the interlock loop is open.", "Close it, then try again.")
        self._instrument.shutter_opened = True
        try:
            self._instrument.scpi.command(b"OUTP:SHUT OPEN", retry=False)
        except ErrorsReported as report:
            if any(error.code > 0 for error in report.errors):
                raise safety_error(self._device, report.errors, "") from report
            raise
        if not self._reads_back(True):
            self.close()
            raise DeviceFault(self._device, "it does not open.", "Check its supply and its feedback contact.")

    def close(self) -> None:
        self._instrument.link.urgent(b"OUTP:SHUT CLOS\n", self._instrument.scpi.timeout_s)
        if not self._reads_back(False):
            raise DeviceFault(
                self._device, "its contact says OPEN after it was told to close.", "Switch the laser off by hand."
            )
        self._instrument.shutter_opened = False

    def state(self) -> ShutterState:
        commanded, feedback, interlock = self._ask()
        return ShutterState(commanded == "OPEN", feedback == "OPEN", interlock == "OK")

    def _reads_back(self, is_open: bool) -> bool:
        deadline_s = self._clock.now() + _MOVES_S
        while True:
            state = self.state()
            if state.commanded_open is is_open and state.feedback_open is is_open:
                return True
            if self._clock.now() >= deadline_s:
                return False
            self._clock.sleep(_LOOK_S)

    def _ask(self) -> tuple[str, str, str]:
        """Commanded, feedback, interlock. Errors that wait in the queue belong to others and do not hinder a look."""
        try:
            shutter, interlock = self._instrument.scpi.query(b"OUTP:SHUT?", b"INTL?")
        except ErrorsReported:
            shutter, interlock = self._instrument.scpi.query(b"OUTP:SHUT?", b"INTL?")
        commanded, _, feedback = shutter.partition(",")
        if not {commanded, feedback} <= {"OPEN", "CLOS"} or interlock not in ("OK", "OPEN"):
            raise ProtocolError(self._device, f"OUTP:SHUT?;:INTL? answered {shutter};{interlock}.")
        return commanded, feedback, interlock

"""A Ctrl-C within any exchange with an instrument ends a scan, or pauses it and loses nothing; it is no fault of an
instrument. Signals at random moments of whole commands: `tests/nlos/test_signals.py`."""

import os
import signal

import pytest

from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import open_bench
from tests.acquisition.fault_cases import BENCHES, plan, settings

SOAK = os.environ.get("NLOS_SOAK") == "1"
PLACES = 2
"""Of a scan, where it is a sample."""


class Interrupted:
    """A scan during whose `at`-th message, to or from an instrument, somebody presses Ctrl-C; 0: nobody does."""

    def __init__(self, name: str, at: int, goes_on: bool) -> None:
        self._at, self.messages = at, 0
        self._scanning = False
        self._control = ScanControl(lambda why: goes_on)
        before = signal.signal(signal.SIGINT, lambda number, frame: self._control.interrupt("Ctrl-C"))
        try:
            with open_bench(settings(name), wire_log=self._message) as bench:
                samples = scan(plan(name), bench, control=self._control)
                self._scanning = True
                self.counts = {sample.point.number: sample.histogram.counts.tobytes() for sample in samples}
                self._scanning = False
                assert bench.simulated is not None
                self.dark = not bench.simulated.shutter_open
        finally:
            signal.signal(signal.SIGINT, before)
        self.state = self._control.state

    def _message(self, device: str, direction: str, data: bytes) -> None:
        if self._scanning:
            self.messages += 1
            if self.messages == self._at:
                signal.raise_signal(signal.SIGINT)


@pytest.mark.soak
@pytest.mark.parametrize("name", BENCHES)
def test_a_signal_within_an_exchange_is_no_fault_of_the_instrument(name: str) -> None:
    whole = Interrupted(name, 0, False)
    assert whole.state is ScanState.COMPLETE
    for at in range(1 if SOAK else 5, whole.messages + 1, 1 if SOAK else whole.messages // PLACES):
        ended = Interrupted(name, at, goes_on=False)
        assert ended.state in (ScanState.ENDED, ScanState.COMPLETE), at
        assert ended.dark
        assert ended.counts == {number: whole.counts[number] for number in ended.counts}
        paused = Interrupted(name, at, goes_on=True)
        assert (paused.state, paused.counts) == (ScanState.COMPLETE, whole.counts), at
        assert paused.dark

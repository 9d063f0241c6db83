"""The states of a running scan, and what a person may ask of it from a signal handler or another thread."""

from collections.abc import Callable, Iterator
from enum import Enum

from nlos.acquisition.sample import Sample
from nlos.drivers.errors import DeviceTimeout, Preempted, ShutterHeld

MOST_SIGNALS = 8
"""That break into one step of a scan; more of them in its few milliseconds are no person's."""

Report = Callable[[str, str], None]
"""(kind, text): where events go."""


class ScanState(Enum):
    """Where a scan is in its life."""

    READY = "ready"
    RUNNING = "running"
    PAUSED = "paused"
    COMPLETE = "complete"
    ENDED = "ended"
    """By a person, or because nothing was left to gain."""
    STOPPED = "stopped"
    """By an alarm or an interlock."""
    FAILED = "failed"
    """By a device or the disk."""


_NEXT = {
    ScanState.READY: {ScanState.RUNNING, ScanState.COMPLETE, ScanState.ENDED, ScanState.STOPPED, ScanState.FAILED},
    ScanState.RUNNING: {
        ScanState.PAUSED,
        ScanState.COMPLETE,
        ScanState.ENDED,
        ScanState.STOPPED,
        ScanState.FAILED,
    },
    ScanState.PAUSED: {ScanState.RUNNING, ScanState.ENDED, ScanState.STOPPED, ScanState.FAILED},
}


class ScanControl:
    """One scan's state machine. `ask_to_go_on` is called while paused, light off: True goes on, False ends."""

    def __init__(self, ask_to_go_on: Callable[[str], bool] | None = None) -> None:
        self._ask = ask_to_go_on or (lambda why: False)
        self._state = ScanState.READY
        self._wanted = ""
        self.scheme = ""
        """By which the scan is taken: not always the one that was chosen before its light."""
        self.expected_s = 0.0
        """How long that takes, with what another scheme had taken before it."""

    @property
    def state(self) -> ScanState:
        return self._state

    @property
    def wanted(self) -> str:
        """Why the scan should pause; empty while nobody asked."""
        return self._wanted

    def interrupt(self, why: str = "a person") -> None:
        """Asks for a pause. `why`: by whom or what, or which alarm. Only notes it, so it may be called from a signal
        handler."""
        self._wanted = why

    def enter(self, state: ScanState) -> None:
        """The engine moves on to `state`. Raises `RuntimeError` for a move that the machine does not know."""
        if state not in _NEXT.get(self._state, set()):
            raise RuntimeError(f"a scan that is {self._state.value} cannot become {state.value}")
        self._state = state

    def pause(self, otherwise: ScanState = ScanState.ENDED) -> bool:
        """Paused until somebody decides; True: running again, False: `otherwise`."""
        why, self._wanted = self._wanted, ""
        self.enter(ScanState.PAUSED)
        if not self._ask(why):
            self.enter(otherwise)
            return False
        self.enter(ScanState.RUNNING)
        return True


def undeterred(step: Callable[[], object]) -> None:
    """Takes a step that may be taken twice, once more where a signal that shut the light broke into its exchange."""
    for _ in range(MOST_SIGNALS):
        try:
            step()
            return
        except Preempted:
            continue
    step()


def until_interrupted(source: Iterator[Sample], control: ScanControl) -> Iterator[Sample]:
    """Samples until a signal handler, shutting the light, breaks into the exchange of the point under way, or comes
    before the light is on."""
    while True:
        try:
            sample = next(source, None)
        except (DeviceTimeout, ShutterHeld):
            if control.wanted:
                return
            raise
        if sample is None:
            return
        yield sample

"""A recording that another process is writing, as a source of samples that ends when the scan does."""

from collections.abc import Callable, Iterator
from pathlib import Path

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.acquisition.sample import Sample
from nlos.drivers.clock import Clock, SystemClock

POLL_S = 0.2
LOOKS_A_FRAME = 5
"""Of a film: how often the file is looked at while a frame is taken, if that is more often."""
FASTEST_POLL_S = 0.01
NEAR_END_POLL_S = 0.05
"""Once what is left would come by the next look: whoever waits for the last sample does not wait for a look as well."""
LOOK_AT_LEAST_S = 1.0
"""How often the file is shown at least while many samples are taken from it in one go, those of before among them."""
LAST_LOOKS = 5
"""How often a row that is not intact is looked at again before it counts as damaged."""
LEFT_ALONE_S = 5.0
"""A file that nobody holds any more gets so long to change before its writer is taken for dead."""


Look = Callable[[Recording], None]


def follow(
    path: Path, *, patience_s: float = 60.0, begun: bool = False, clock: Clock | None = None, look: Look | None = None
) -> Iterator[Sample]:
    """The intact samples of `path`, those already there first, then each as it is acknowledged, until the scan ends.

    `look` is shown the open recording before the first sample, whenever it was looked at again, every second while many
    samples are given that were there already, and once at the end: whoever wants to know more than samples needs no
    second handle, which would upset this one.

    Waits at most `patience_s` for the file to appear (`TimeoutError`); then for as long as a writer holds it, pauses
    included. `begun`: it has been there already, so where it is not and nobody writes it, it is not waited for.
    Continues through a crash and `--resume`. Raises `InvalidData` for a file that is not a recording and that nobody
    writes, `StorageError` where the writer is gone for good, the file was deleted, or another recording has taken its
    place.
    """
    clock, look = clock or SystemClock(), look or (lambda recording: None)
    given, identity = 0, ""
    while True:
        with _opened(path, patience_s, clock, given, begun) as recording:
            if identity and recording.header.identity != identity:
                raise StorageError(f"{path}: another recording took its place after {given} samples. Follow it again.")
            identity = recording.header.identity
            row, looks, alone_since_s, skip, near_end = 0, 0, clock.now(), given, False
            while True:
                over = recording.status is not Status.RUNNING
                recording.refresh()
                look(recording)
                before, looked_s = row, clock.now()
                for sample in recording.rows(row):
                    if sample is None:
                        looks += 1
                        if looks < LAST_LOOKS or (not over and row >= recording.acknowledged):
                            break  # on its way to the disk, or a network's view of it is old
                    elif skip:
                        skip -= 1  # given before the file was replaced by its resumed self
                    else:
                        given += 1
                        yield sample
                    row, looks, alone_since_s = row + 1, 0, clock.now()
                    if not over and alone_since_s - looked_s >= LOOK_AT_LEAST_S:
                        look(recording)
                        looked_s = clock.now()
                if over and row >= len(recording):
                    look(recording)
                    return
                if not recording.has_its_name():
                    break
                if is_locked(path):
                    alone_since_s = clock.now()
                elif not over and clock.now() - alone_since_s > LEFT_ALONE_S:
                    if not recording.missing():
                        return  # killed after its last sample
                    raise StorageError(
                        f"{path}: its writer is gone after {given} samples. Use --resume or `nlos recover`."
                    )
                near_end = near_end or recording.plan.most_samples - row <= row - before
                clock.sleep(min(_pause_s(recording.plan), NEAR_END_POLL_S if near_end else POLL_S))


def _pause_s(plan: ScanPlan) -> float:
    """How long to wait for more of a recording."""
    if plan.frames == 1:
        return POLL_S
    return min(POLL_S, max(plan.dwell_total_s / plan.frames / LOOKS_A_FRAME, FASTEST_POLL_S))


def _opened(path: Path, patience_s: float, clock: Clock, given: int, begun: bool) -> Recording:
    """The recording, once it is there. A file that cannot be read yet may be on its way."""
    began_s = clock.now()
    deadline_s = began_s + patience_s
    while True:
        try:
            return open_checked(path)
        except (FileNotFoundError, InvalidData) as error:
            alone = not is_locked(path) and clock.now() - began_s > LEFT_ALONE_S
            if alone and path.exists():
                raise
            if clock.now() - began_s > LEFT_ALONE_S and given:
                raise StorageError(f"{path}: was deleted or moved after {given} samples.") from error
            if alone and begun:
                raise StorageError(
                    f"{path}: was deleted or moved before it was opened here, and nobody writes it any more. See the "
                    "scan's terminal for how it ended."
                ) from error
            if clock.now() >= deadline_s:
                raise TimeoutError(f"{path}: no recording to follow after {patience_s:g} s ({error})") from error
        clock.sleep(POLL_S)

"""Who does the files of an archive: this process, Dask workers, or both; and what is under way when it ends early.

Every thread of a worker has one file, and gets the next when that is done: nothing lies at a worker that it could begin
after the command has ended.
"""

import logging
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from nlos.acquisition.importers.isolated import one_reader
from nlos.cli.archive_on_dask import gone, outcome_of, submit
from nlos.cli.archive_task import Outcome, Task, attempt
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)
POLL_S = 0.5
"""Workers come and go: they are counted so often."""
CLOSING_S = 30.0
"""Workers of this machine are waited for so long, once they have been told to end."""
THREADS = "OMP_NUM_THREADS"


class Crew:
    """The files of one archive, given to whoever is free; `here`: this process does files, too."""

    def __init__(self, tasks: Sequence[Task], address: str = "", *, here: bool) -> None:
        self.address, self._here = address, here
        self._left, self._lock = deque(tasks), threading.Lock()
        self._given: dict[Future[Outcome], Task] = {}
        self._ended: SimpleQueue[Future[Outcome]] = SimpleQueue()
        self._over, self._workers, self._told = threading.Event(), 0, here
        self._client: Client | None = None
        self._beside: threading.Thread | None = None

    def begin_workers(self, connected: AbstractContextManager["Client"]) -> None:
        """From now on workers take part, as soon as `connected` has been entered; it is left when the crew ends. That
        happens beside: this process does files meanwhile."""
        self._beside = threading.Thread(target=self._give_out_to, args=(connected,), name="archive", daemon=True)
        self._beside.start()

    def outcomes(self) -> Iterator[Outcome]:
        """One a file, as they come. Where the scheduler goes, what it had and what is left is unfinished."""
        with one_reader():
            while self._left or self._given:
                yield from self._ended_within(0.0)
                if self._here and (task := self._next()) is not None:
                    with _one_thread(self._workers > 0), terminal.log_of(task.file):
                        outcome = attempt(task)
                    yield outcome
                elif self._lost():
                    with self._lock:
                        lost = [*self._given.values(), *self._left]
                        self._given.clear()
                        self._left.clear()
                    yield from (gone(task, self.address) for task in lost)
                else:
                    yield from self._ended_within(POLL_S)

    def left(self) -> int:
        """How many files nobody has begun."""
        return len(self._left)

    def under_way(self) -> list[Task]:
        """What workers have begun and not ended."""
        with self._lock:
            return [task for future, task in self._given.items() if not future.done()]

    def give_out_no_more(self) -> None:
        """What nobody has begun stays undone."""
        with self._lock:
            self._left.clear()

    def outcomes_under_way(self, within_s: float) -> Iterator[Outcome]:
        """Of what workers have begun, as far as it ends in time; what `outcomes` was handing over comes once more."""
        deadline = time.monotonic() + within_s
        while True:
            for future in [future for future in self._given if future.done()]:
                self._ended.put(future)
            yield from self._ended_within(0.0)
            left_s = deadline - time.monotonic()
            if not self._given or self._lost() or left_s <= 0:
                return
            yield from self._ended_within(min(left_s, POLL_S))

    def end(self) -> None:
        """No more files are given out; workers that were begun for this archive end."""
        self._over.set()
        self.give_out_no_more()
        if self._beside is not None:
            self._beside.join(CLOSING_S)

    def _next(self) -> Task | None:
        with self._lock:
            return self._left.popleft() if self._left else None

    def _ended_within(self, wait_s: float) -> Iterator[Outcome]:
        """Those that have ended, the first of them waited for."""
        try:
            future = self._ended.get(timeout=wait_s) if wait_s else self._ended.get_nowait()
            while True:
                if (task := self._given.get(future)) is not None:
                    yield outcome_of(future, task, self.address)
                    with self._lock:
                        self._given.pop(future, None)
                future = self._ended.get_nowait()
        except Empty:
            return

    def _lost(self) -> bool:
        return self._client is not None and self._client.status != "running"

    def _give_out_to(self, connected: AbstractContextManager["Client"]) -> None:
        """What the thread beside does, until the archive is over."""
        if hasattr(signal, "pthread_sigmask"):
            # A terminal sends Ctrl-C to workers as well: those begun from here never hear of it.
            signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            with connected as client:
                self._client = client
                while not self._over.is_set():
                    with suppress(OSError, TimeoutError):  # asked again; where the scheduler is gone, the client knows
                        self._workers = sum(client.nthreads().values())
                    if not self._workers and not self._told:
                        log.warning("the scheduler %s has no workers yet; waiting for them", self.address)
                        self._told = True
                    self._give_out()
                    self._over.wait(POLL_S)
        except (OSError, RuntimeError, ValueError, ImportError) as error:
            if self._client is None:  # else it went away, and what it had is said not to be done
                log.warning("no workers could be started (%s); the files are done without", error)

    def _give_out(self) -> None:
        with self._lock:
            while self._left and sum(not future.done() for future in self._given) < self._workers and not self._lost():
                assert self._client is not None
                task = self._left.popleft()
                future = submit(self._client, task)
                self._given[future] = task
                future.add_done_callback(self._one_ended)

    def _one_ended(self, future: "Future[Outcome]") -> None:
        """Called by Dask, in a thread of its own."""
        self._ended.put(future)
        self._give_out()


@contextmanager
def _one_thread(only: bool) -> Iterator[None]:
    """One thread for what computes here, while workers of one thread each have the other cores."""
    if not only:
        yield
        return
    before, torch = os.environ.get(THREADS), sys.modules.get("torch")
    threads = torch.get_num_threads() if torch is not None else 0
    os.environ[THREADS] = "1"
    if torch is not None:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if before is None:
            del os.environ[THREADS]
        else:
            os.environ[THREADS] = before
        if torch is not None:
            torch.set_num_threads(threads)

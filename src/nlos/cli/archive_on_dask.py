"""An archive on a Dask cluster: each result as on one machine, taken up by another worker where one dies.

Workers reach the recordings and the folders of results by the same paths. Dask trusts whoever reaches its scheduler:
that port belongs on loopback or a private network.
"""

import logging
import os
import signal
import socket
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from nlos.acquisition.importers.isolated import IsolatedReader, reading_by
from nlos.bench_constants import NONE
from nlos.cli.archive_task import LOCAL, Outcome, Task, attempt
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.recon.own_methods import in_a_file

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

log = logging.getLogger(__name__)
_of_thread = threading.local()
ANSWERS_S = 10
"""A scheduler that does not answer for this long does not exist, or has gone."""


def on_workers(client: "Client", tasks: Sequence[Task], address: str) -> Iterator[Outcome]:
    """One outcome a task as they come. A task whose worker died is taken up by another, until Dask holds the task for
    the reason (`distributed.scheduler.allowed-failures`); one that failed is not tried again. Where the scheduler
    goes, what it had is unfinished."""
    from distributed import as_completed

    if not client.scheduler_info().get("workers"):
        log.warning("the scheduler %s has no workers yet; waiting for them", address)
    futures = {client.submit(attempt_on_worker, _absolute(task), pure=False): task for task in tasks}
    waiting = as_completed(futures)
    for future in waiting:
        yield _outcome(future, futures[future], address)


def attempt_on_worker(task: Task) -> Outcome:
    """`attempt`, all files of one thread read by one child: starting it takes as long as a small reconstruction."""
    if not hasattr(_of_thread, "reader"):
        _of_thread.reader = IsolatedReader()  # ends with this process: its input ends then
    with reading_by(_of_thread.reader):
        return attempt(task)


def cores() -> int:
    """How many processes this machine can run at a time."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _outcome(future: "Future[Outcome]", task: Task, address: str) -> Outcome:
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    try:
        outcome = future.result(timeout=ANSWERS_S)
    except KilledWorker as error:
        reason = f"the workers that had it died ({error})"
        return Outcome(task.file, "failed", reason, int(ExitCode.RECONSTRUCTION), None, "")
    except (CancelledError, FutureCancelledError, TimeoutError, OSError):
        reason = f"the scheduler {address} is gone, before this file's result was known"
        return Outcome(task.file, "unfinished", reason, int(ExitCode.DEADLINE), None, "")
    assert isinstance(outcome, Outcome)
    return outcome


def _absolute(task: Task) -> Task:
    """The same task for a process with another working directory."""
    recipe = task.recipe
    settings, constants, method = dict(recipe.settings), recipe.constants, recipe.method
    weights = settings.get("weights")
    if isinstance(weights, str) and Path(weights).is_file():
        settings["weights"] = str(Path(weights).resolve())
    if constants is not None and constants != NONE:
        constants = constants.resolve()
    if in_a_file(method):
        method = str(Path(method).expanduser().resolve())
    recipe = replace(recipe, method=method, settings=settings, constants=constants)
    return replace(
        task, run=task.run.resolve(), recipe=recipe, results=replace(task.results, path=task.results.path.resolve())
    )


@contextmanager
def connected(address: str) -> Iterator["Client"]:
    """A client of the scheduler at `address`; `local` starts one worker process a core. Raises `Stopped`."""
    if address != LOCAL:
        _refuse_silence(address)
    from distributed import Client, LocalCluster

    _silence_dask()
    if address == LOCAL:
        each = {"threads_per_worker": 1, "preload": __name__}
        with LocalCluster(n_workers=cores(), dashboard_address=None, **each) as cluster, Client(cluster) as client:
            yield client
        return
    try:
        client = Client(address, timeout=ANSWERS_S)
    except (OSError, ValueError) as error:
        raise _no_answer(address, error) from error
    except TypeError as error:  # Dask's own, for an address without the certificates that it needs
        raise UsageError(
            f"--scheduler {address}: Dask's configuration names no certificates for it (distributed.comm.tls)"
        ) from error
    try:
        yield client
    finally:
        client.close(timeout=ANSWERS_S)


def dask_setup(worker: "Worker") -> None:
    """Called by Dask in each worker that this command started. A terminal sends Ctrl-C to them, too: the command alone
    decides what ends, and says so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _silence_dask()


def _silence_dask() -> None:
    """What became of files is said in lines of our own."""
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "asyncio", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _refuse_silence(address: str) -> None:
    """Asks for a connection, before anything is loaded or written. Raises `Stopped` where nobody takes it; an address
    that is no host and port is left to Dask."""
    place = urlsplit(address if "://" in address else f"tcp://{address}")
    try:
        host, port = place.hostname, place.port
    except ValueError as error:
        raise UsageError(f"--scheduler {address}: {error}. tcp://HOST:PORT is expected, or `local`.") from error
    if place.scheme not in ("tcp", "tls"):
        return
    if not host or not port:
        raise UsageError(f"--scheduler {address}: tcp://HOST:PORT is expected, or `local` for workers on this machine.")
    try:
        socket.create_connection((host, port), ANSWERS_S / 2).close()
    except OSError as error:
        raise _no_answer(address, error) from error


def _no_answer(address: str, error: Exception) -> Stopped:
    return Stopped(
        ExitCode.DEADLINE,
        f"--scheduler {address}: no Dask scheduler answers ({error}). Is `dask scheduler` running there? Nothing was "
        "written.",
    )

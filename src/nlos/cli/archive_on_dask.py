"""An archive on a Dask cluster: each result as on one machine, taken up by another worker where one dies.

Workers reach the recordings and the folders of results by the same paths. Dask trusts whoever reaches its scheduler:
that port belongs on loopback or a private network.
"""

import logging
import signal
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from nlos.acquisition.importers.isolated import IsolatedReader, reading_by
from nlos.bench_constants import NONE
from nlos.cli.archive_task import Outcome, Task, attempt
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.recon.own_methods import in_a_file

if TYPE_CHECKING:
    from distributed import Client, Future, Worker

_of_thread = threading.local()
ANSWERS_S = 10
"""A scheduler that does not answer for this long does not exist, or has gone."""


def submit(client: "Client", task: Task) -> "Future[Outcome]":
    """Given to a worker. One that dies has its file taken up by another, until Dask holds the file for the reason
    (`distributed.scheduler.allowed-failures`); what failed is not tried again."""
    return client.submit(attempt_on_worker, _absolute(task), pure=False)


def attempt_on_worker(task: Task) -> Outcome:
    """`attempt`, all files of one thread read by one child: starting it takes as long as a small reconstruction."""
    if not hasattr(_of_thread, "reader"):
        _of_thread.reader = IsolatedReader()  # ends with this process: its input ends then
    with reading_by(_of_thread.reader):
        return attempt(task)


def outcome_of(future: "Future[Outcome]", task: Task, address: str) -> Outcome:
    """What a worker made of a file, or why nobody knows."""
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    try:
        outcome = future.result(timeout=ANSWERS_S)
    except KilledWorker as error:
        reason = f"the workers that had it died ({error})"
        return Outcome(task.file, "failed", reason, int(ExitCode.RECONSTRUCTION), None, "")
    except (CancelledError, FutureCancelledError, TimeoutError, OSError):
        return gone(task, address)
    assert isinstance(outcome, Outcome)
    return outcome


def gone(task: Task, address: str) -> Outcome:
    """Of a file whose scheduler went away."""
    reason = f"the scheduler {address} is gone, before this file's result was known"
    return Outcome(task.file, "unfinished", reason, int(ExitCode.DEADLINE), None, "")


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
def local_workers(count: int) -> Iterator["Client"]:
    """A client of so many workers on this machine, of one thread each. They end with it."""
    from distributed import Client, LocalCluster

    _silence_dask()
    each = {"threads_per_worker": 1, "preload": __name__}
    with LocalCluster(n_workers=count, dashboard_address=None, **each) as cluster, Client(cluster) as client:
        yield client


@contextmanager
def connected(address: str) -> Iterator["Client"]:
    """A client of the scheduler at `address`. Raises `Stopped` where none answers."""
    _refuse_silence(address)
    from distributed import Client

    _silence_dask()
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

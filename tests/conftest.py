"""One thread a test process: several run side by side, and threads that wait for each other's cores cost all. A test
that waits for ever fails after a while, and says where."""

import atexit
import contextlib
import itertools
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest
from hypothesis import settings

from tests import campaign_journal, sampled
from tests.chromium import CHROMIUM
from tests.left_behind import MARK, Held, end_processes, left_behind

_STATE = tempfile.mkdtemp(prefix="nlos-state-")
atexit.register(shutil.rmtree, _STATE, ignore_errors=True)
_numbers = itertools.count()
LONGEST_S = 600.0
"""Of a test, outside campaigns. Here and where a test waits for a program, deadlines are those of a machine that is ten
times as slow as usual: they end what hangs, and judge no speed."""
SAID = 2000
"""Characters of a failure that are said at once."""
os.environ["NLOS_STATE"] = _STATE
os.environ[MARK] = str(os.getpid())
# Whoever shares the processor must not fail a case: how long one takes is judged nowhere.
settings.register_profile("new cases", deadline=None)
settings.register_profile("the same cases every time", derandomize=True, deadline=None)
settings.load_profile("new cases" if os.environ.get("NLOS_SOAK") == "1" else "the same cases every time")

# A run in the background, or under nohup, begins with these ignored, and so would every program that a test signals.
for number, usual in ((signal.SIGINT, signal.default_int_handler), *(
    (getattr(signal, name), signal.SIG_DFL) for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name)
)):  # fmt: skip
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, usual)

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    if os.environ.get("NLOS_SOAK") == "1" or not hasattr(signal, "pthread_kill"):
        return (yield)

    held = Held.now()

    def overdue(number: int, frame: FrameType | None) -> None:
        end_processes(held)  # a block that waits for its program would go on waiting
        raise TimeoutError(f"{item.nodeid} took more than {LONGEST_S:g} s")

    before = signal.signal(signal.SIGUSR1, overdue)
    timer = threading.Timer(LONGEST_S, signal.pthread_kill, (threading.main_thread().ident, signal.SIGUSR1))
    timer.daemon = True
    timer.start()
    try:
        return (yield)
    finally:
        timer.cancel()
        timer.join()
        signal.signal(signal.SIGUSR1, before)


@pytest.hookimpl(tryfirst=True)  # what is left to `make soak` is of its marker
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    sampled.leave_to_soak(config, items)
    campaign_journal.deselect_what_has_passed(config, items)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    campaign_journal.write(report)
    if report.failed and "PYTEST_XDIST_WORKER" not in os.environ and sys.__stderr__ is not None:
        # At once: a run that is broken off later prints no summary.
        said = [report.longreprtext, *(f"{name}: {text}" for name, text in report.sections)]
        sys.__stderr__.write("\n".join(["", f"{report.nodeid} ({report.when})", *(each[-SAID:] for each in said), ""]))
        sys.__stderr__.flush()


@pytest.fixture(autouse=True)
def trips_of_a_test_stay_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trips outlast a program; not a test, nor do they reach whoever runs the tests."""
    monkeypatch.setenv("NLOS_STATE", os.path.join(_STATE, str(next(_numbers))))


@pytest.fixture(autouse=True)
def nothing_is_left_behind() -> Iterator[None]:
    """No test leaves a descriptor, a socket, a thread or a process behind; what its module's fixtures hold was there
    before it began."""
    before = Held.now()
    yield
    left = left_behind(before)
    if left:
        end_processes(before)
    assert left == []


@pytest.fixture(scope="module")
def one_child_reads(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """All files that a module's tests read are read by one child, begun before the first: where no file ends it."""
    from nlos.acquisition.errors import InvalidData
    from nlos.acquisition.importers.isolated import one_reader

    empty = tmp_path_factory.mktemp("begun") / "empty.h5"
    empty.touch()
    with one_reader() as reader:
        with contextlib.suppress(InvalidData):
            reader.check(empty, "nlos.acquisition.recording.read_by_child:read_through")
        yield


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, for modules that are marked `needs_chromium`."""
    from playwright import sync_api

    with sync_api.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield chromium
        chromium.close()

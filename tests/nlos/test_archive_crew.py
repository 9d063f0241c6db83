"""Who does the files of an archive, and what becomes of those under way when it is told to end."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from nlos.cli import archive, archive_crew, archive_on_dask, archive_on_this_machine
from nlos.cli.archive_crew import Crew
from nlos.cli.archive_on_this_machine import processes_of
from nlos.cli.archive_task import Outcome, Task
from nlos.cli.exit_codes import UsageError
from nlos.recipe import Recipe
from nlos.recon.control_group import processors
from nlos.results_folder import ResultsFolder
from tests.nlos.test_archives import SOAK, dask, free_port, record, times
from tests.nlos.test_archives import archive as scans

WAIT_S = 20.0


def tasks(count: int) -> list[Task]:
    return [Task(f"{n}.h5", Path(f"{n}.h5"), Recipe("lct"), ResultsFolder(Path("out") / str(n))) for n in range(count)]


class Slow:
    """What does a file: it says that it has begun it, and ends it when it may."""

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.done: list[str] = []
        self.may_end = threading.Event()

    def __call__(self, task: Task) -> Outcome:
        self.begun.append(task.file)
        if len(self.begun) > 1:
            assert self.may_end.wait(WAIT_S)
        self.done.append(task.file)
        return Outcome(task.file, "done", "", 0, 0.1, "here:1")


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[Slow]:
    slow = Slow()
    monkeypatch.setattr(archive_on_dask, "attempt", slow)
    yield slow
    slow.may_end.set()


@contextmanager
def two_threads() -> Iterator[Any]:
    """A client of a scheduler and a worker of two threads, all in this process."""
    distributed = pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    one = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**one) as cluster, distributed.Client(cluster) as client:
        yield client


def until(true: Any) -> None:
    deadline = time.monotonic() + WAIT_S
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.filterwarnings("ignore")
def test_what_is_under_way_at_the_end_is_recorded_and_nothing_more_is_begun(
    slow: Slow, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    taken: dict[str, Outcome] = {}

    def take(outcome: Outcome) -> None:
        taken[outcome.file] = outcome

    with two_threads() as client:
        crew = Crew(tasks(9), "tcp://scheduler", here=False)
        crew.begin_workers(archive.nullcontext(client))
        take(next(crew.outcomes()))
        until(lambda: len(slow.begun) == 3)
        threading.Timer(0.3, slow.may_end.set).start()
        archive._end_early(crew, take)
        until(lambda: not client.futures or len(slow.done) == len(slow.begun))
        assert sorted(slow.begun) == sorted(slow.done) == sorted(taken)
        assert {outcome.outcome for outcome in taken.values()} == {"done"}
        assert len(taken) == 3, "one file for each thread at a time"
        assert "waiting up to 30 s for 2 files that workers have begun: " in capsys.readouterr().err

        slow.may_end.clear()
        monkeypatch.setattr(archive, "WAITS_S", 0.2)
        crew = Crew(tasks(9), "tcp://scheduler", here=False)
        crew.begin_workers(archive.nullcontext(client))
        until(lambda: len(slow.begun) == 5)
        archive._end_early(crew, take)
        assert [taken[name].outcome for name in slow.begun[3:]] == ["unfinished"] * 2
        assert "a worker had begun it when the command ended" in taken[slow.begun[4]].reason
        slow.may_end.set()
        until(lambda: len(slow.done) == 5)


def test_this_process_does_files_while_workers_start_and_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    starts, started = threading.Event(), threading.Event()
    who: dict[str, str] = {}

    def attempt_by(name: str) -> Any:
        def attempt(task: Task) -> Outcome:
            who[task.file] = name
            if len(who) == 4:
                starts.set()
                assert started.wait(WAIT_S)
            time.sleep(0.05)
            return Outcome(task.file, "done", "", 0, 100.0, name)

        return attempt

    @contextmanager
    def workers(count: int) -> Iterator[Any]:
        assert count == 2
        assert starts.wait(WAIT_S)
        with two_threads() as client:
            started.set()
            yield client

    monkeypatch.setattr(archive_crew, "attempt", attempt_by("here"))
    monkeypatch.setattr(archive_on_dask, "attempt", attempt_by("there"))
    monkeypatch.setattr(archive_on_this_machine, "local_workers", workers)
    monkeypatch.setattr(archive_on_this_machine, "STARTUP_S", 0.0)
    crew = Crew(tasks(40), here=True)
    done = [outcome.file for outcome in archive_on_this_machine.begun_when_worth_it(crew, 3)]
    crew.end()
    assert sorted(done) == sorted(task.file for task in tasks(40))
    by = list(who.values())
    assert by[:4] == ["here"] * 4
    assert by.count("there") > 5
    assert by.count("here") > 5


def test_workers_that_cannot_be_started_leave_the_files_to_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    @contextmanager
    def none(count: int) -> Iterator[Any]:
        raise OSError("too many open files")
        yield

    monkeypatch.setattr(archive_crew, "attempt", lambda task: Outcome(task.file, "done", "", 0, 100.0, "here"))
    monkeypatch.setattr(archive_on_this_machine, "local_workers", none)
    monkeypatch.setattr(archive_on_this_machine, "STARTUP_S", 0.0)
    monkeypatch.setattr(archive_crew.log, "warning", lambda text, *values: said.append(text % values))
    crew = Crew(tasks(9), here=True)
    assert len(list(archive_on_this_machine.begun_when_worth_it(crew, 3))) == 9
    crew.end()
    assert said == ["no workers could be started (too many open files); the files are done without"]


def test_how_many_processes_local_asks_for() -> None:
    assert processes_of("local") == processors()
    assert processes_of("local:3") == 3
    assert processes_of("tcp://127.0.0.1:8786") is None
    for word in ("local:", "local:0", "local:many", "local:-1"):
        with pytest.raises(UsageError, match="local:N is expected"):
            processes_of(word)


def test_one_thread_beside_workers_and_as_many_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    from nlos.recon.transport.fourier import threads

    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    assert threads() == 5, "as torch has it"
    with archive_crew._one_thread(only=True):
        assert threads() == 1
    assert threads() == 5
    monkeypatch.delenv("OMP_NUM_THREADS")
    with archive_crew._one_thread(only=True):
        assert threads() == 1
    assert threads() == processors()


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="half a minute: make soak")
@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_at_a_cluster_leaves_a_record_of_what_the_folder_holds(tmp_path: Path, presses: int) -> None:
    scans(tmp_path / "in", 30, points=64, bins=512)
    with dask(tmp_path, port := free_port(), 2):
        words = ["reconstruct", "in", "-o", "out", "--no-volume", "--scheduler", f"tcp://127.0.0.1:{port}"]
        with subprocess.Popen(
            [sys.executable, "-m", "nlos", *words], cwd=tmp_path, stderr=subprocess.PIPE, text=True
        ) as process:
            until_s = time.monotonic() + 120
            while len(list((tmp_path / "out").glob("*/depth.png"))) < 5 and time.monotonic() < until_s:
                time.sleep(0.02)
            for _ in range(presses):
                process.send_signal(signal.SIGINT)
                time.sleep(0.3)
            said = process.communicate(timeout=240)[1]
        time.sleep(5)  # what goes on after the command has ended
        rows, there = record(tmp_path / "out"), times(tmp_path / "out")
        again = subprocess.run(
            [sys.executable, "-m", "nlos", *words, "--skip-existing"],
            cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False,
        )  # fmt: skip
    assert process.returncode == 130, said
    assert "waiting up to" in said
    assert "Traceback" not in said
    done = {name for name, row in rows.items() if row["outcome"] == "done"}
    begun = {name for name, row in rows.items() if "whether it finished" in row["reason"]}
    assert done <= set(there) <= done | begun
    assert begun == set() or presses == 2
    assert again.returncode == 7, again.stderr  # five files are broken
    assert f"{len(done)} of 35 files already exist, skipped" in again.stderr
    after = times(tmp_path / "out")
    assert {name for name in done if after[name] != there[name]} == set()
    rows = record(tmp_path / "out")
    assert {name for name, row in rows.items() if row["outcome"] == "done"} == set(after)
    assert len(after) == 30

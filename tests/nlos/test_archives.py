"""Archives: every file has its own outcome; nothing is lost to a file, a worker or a scheduler."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.cli import archive_on_this_machine
from nlos.cli.archive import files_of, folders_for, reconstruct_archive, worst
from nlos.cli.archive_on_dask import connected, dask_setup
from nlos.cli.archive_record import ArchiveRecord
from nlos.cli.archive_task import Outcome, Task
from nlos.cli.exit_codes import UsageError
from nlos.recipe import Recipe
from nlos.results_folder import ResultsFolder
from tests import command

SOAK = bool(os.environ.get("NLOS_SOAK"))


def scan(path: Path, seed: int, points: int = 8, bins: int = 64) -> Path:
    with h5py.File(path, "w") as file:
        file["histograms"] = np.random.default_rng(seed).poisson(1.0, (points, points, bins)).astype(np.uint16)
        file.attrs.update({"bin_width_s": 64e-12, "wall_size_m": 1.0})
    return path


def archive(folder: Path, good: int, points: int = 8, bins: int = 64) -> Path:
    """`good` scans, and five that are broken each in its own way."""
    folder.mkdir()
    for number in range(good):
        scan(folder / f"good_{number:03d}.h5", number, points, bins)
    whole = (folder / "good_000.h5").read_bytes()
    (folder / "broken_cut.h5").write_bytes(whole[: len(whole) // 2])
    (folder / "broken_empty.h5").write_bytes(b"")
    (folder / "broken_noise.npz").write_bytes(np.random.default_rng(9).bytes(4000))
    with h5py.File(scan(folder / "broken_dark.h5", 0), "a") as file:
        file["histograms"][...] = 0
    with h5py.File(scan(folder / "broken_nameless.h5", 0), "a") as file:
        del file["histograms"]
    return folder


def nlos(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    """As a process: its workers, and Dask's threads, end with it."""
    return subprocess.run(
        [sys.executable, "-m", "nlos", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=1500 if SOAK else 500,
        check=False,
    )


def any_left(group: int) -> bool:
    """Whether there is a process of this group."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def record(folder: Path) -> dict[str, dict[str, Any]]:
    rows = json.loads((folder / "archive.json").read_text())
    return {Path(row["file"]).stem: row for row in rows}


def albedo(folder: Path) -> Any:
    with h5py.File(folder / "reconstruction.h5") as file:
        return np.asarray(file["albedo"])


def times(folder: Path) -> dict[str, int]:
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/reconstruction.h5")}


@contextmanager
def dask(folder: Path, port: int, workers: int) -> Iterator[tuple["subprocess.Popen[bytes]", list[Any]]]:
    """A scheduler on 127.0.0.1 and workers, each a process of its own."""
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    address, quiet = f"tcp://127.0.0.1:{port}", {"cwd": folder, "stderr": subprocess.DEVNULL}
    base = [sys.executable, "-m", "distributed.cli"]
    words = [f"{base[2]}.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    scheduler = subprocess.Popen([*base[:2], *words], **quiet)  # type: ignore[call-overload]
    words = [f"{base[2]}.dask_worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
    crew = [
        subprocess.Popen([*base[:2], *words, "--death-timeout", "30"], **quiet)  # type: ignore[call-overload]
        for _ in range(workers)
    ]
    try:
        deadline = time.monotonic() + 240
        while time.monotonic() < deadline:
            with socket.socket() as door:
                if door.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        yield scheduler, crew
    finally:
        for process in (*crew, scheduler):
            process.kill()
            process.wait()


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def test_times_of_flight_beside_a_measurement_are_no_scan(tmp_path: Path) -> None:
    for name in ("meas_10min.mat", "tof.mat", "tof_raw.mat"):
        (tmp_path / name).write_bytes(b"")
    assert files_of([tmp_path]) == [tmp_path / "meas_10min.mat"]
    assert files_of([tmp_path / "tof.mat"]) == [tmp_path / "tof.mat"]
    (tmp_path / "meas_10min.mat").unlink()
    assert files_of([tmp_path]) == [tmp_path / "tof.mat", tmp_path / "tof_raw.mat"]


def test_the_broken_are_named_with_their_reasons_and_the_others_are_done(tmp_path: Path) -> None:
    archive(tmp_path / "in", 3)
    done = command.nlos(tmp_path, "reconstruct", "in", "-o", "out")
    assert done.returncode == 7, done.stderr
    rows = record(tmp_path / "out")
    assert len(rows) == 8
    reasons = {"cut": "reader|truncated|HDF5", "empty": "begins with|empty", "dark": "every count is 0"}
    for name, row in rows.items():
        assert row["outcome"] == ("failed" if name.startswith("broken") else "done"), row
        assert row["worker"].rpartition(":")[2].isdigit()
        assert row["seconds"] > 0
        assert bool(row["reason"]) == name.startswith("broken")
        assert f"in/{name}" in done.stderr or not name.startswith("broken")
    for name, words in reasons.items():
        assert any(word in rows[f"broken_{name}"]["reason"] for word in words.split("|")), rows[f"broken_{name}"]
    assert "5 of 8 files without a result" in done.stderr
    assert "Traceback" not in done.stderr
    assert not re.search(r"^(in/[^:]+): (failed: )?\1: ", done.stderr, re.M), "a file is named twice in a line"
    page = (tmp_path / "out" / "index.html").read_text()
    assert page.count("<figure>") == 3
    assert page.count("albedo.png") == 3
    assert page.count("<tr><td>") == 5
    for number in range(3):
        alone = tmp_path / f"alone{number}"
        assert command.nlos(tmp_path, "reconstruct", f"in/good_{number:03d}.h5", "-o", str(alone)).returncode == 0
        assert np.array_equal(albedo(alone), albedo(tmp_path / "out" / f"good_{number:03d}"))


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="half a minute: make soak")
def test_skip_existing_does_what_is_missing_and_nothing_twice(tmp_path: Path) -> None:
    archive(tmp_path / "in", 3)
    first = [f"in/good_00{number}.h5" for number in (0, 1)]
    assert nlos(tmp_path, "reconstruct", *first, "-o", "out").returncode == 0
    before = times(tmp_path / "out")
    refused = nlos(tmp_path, "reconstruct", "in", "-o", "out")
    assert refused.returncode == 6
    assert "--skip-existing" in refused.stderr
    (tmp_path / "out" / "good_001" / "depth.png").unlink()  # half a result, of a process that was killed
    whole = nlos(tmp_path, "reconstruct", "in", "-o", "out", "--skip-existing")
    assert whole.returncode == 7
    assert "1 of 8 files already exist, skipped" in whole.stderr
    after = times(tmp_path / "out")
    assert sorted(after) == ["good_000", "good_001", "good_002"]
    assert after["good_000"] == before["good_000"]
    assert after["good_001"] > before["good_001"]
    other = nlos(tmp_path, "reconstruct", "in", "-o", "out", "--skip-existing", "--method", "fk")
    assert other.returncode == 6
    assert "holds a result of lct" in other.stderr
    (tmp_path / "out" / "archive.json").unlink()  # results of an earlier version
    assert nlos(tmp_path, "reconstruct", *first, "-o", "out", "--skip-existing").returncode == 0
    assert times(tmp_path / "out") == after


def test_one_file_is_skipped_too(tmp_path: Path) -> None:
    scan(tmp_path / "a.h5", 1)
    words = ("reconstruct", "a.h5", "-o", "out", "--skip-existing")
    assert command.nlos(tmp_path, *words).returncode == 0
    before = (tmp_path / "out" / "reconstruction.h5").stat().st_mtime_ns
    assert command.nlos(tmp_path, *words).returncode == 0
    assert (tmp_path / "out" / "reconstruction.h5").stat().st_mtime_ns == before


def test_two_archives_into_one_folder_at_once_lose_no_row(tmp_path: Path) -> None:
    def task(name: str) -> Task:
        (tmp_path / name).touch()
        return Task(name, tmp_path / name, Recipe("lct"), ResultsFolder(tmp_path / "out" / Path(name).stem))

    def made(name: str, reason: str = "") -> Outcome:
        return Outcome(name, "done", reason, 0, None, "")

    begun = ArchiveRecord(tmp_path / "out")
    begun.begin([task("a.h5"), task("b.h5")])
    one, other = ArchiveRecord(tmp_path / "out"), ArchiveRecord(tmp_path / "out")
    with one, other:
        one.begin([task("a.h5")])
        other.begin([task("b.h5"), task("c.h5")])
        one.add(task("a.h5"), made("a.h5"))
        other.add(task("b.h5"), made("b.h5"))
        other.add(task("c.h5"), made("c.h5"))
    rows = json.loads((tmp_path / "out" / "archive.json").read_text())
    assert [(row["file"], row["outcome"]) for row in rows] == [(f"{name}.h5", "done") for name in "abc"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"archive.json", "index.html"}


def test_files_of_one_name_get_folders_of_their_own_or_are_refused(tmp_path: Path) -> None:
    for name in ("a.h5", "a.mat", "b.npz", "c.txt", ".hidden.h5"):
        (tmp_path / name).touch()
    found = files_of([tmp_path])
    assert [path.name for path in found] == ["a.h5", "a.mat", "b.npz"]
    assert [path.name for path in folders_for(found, tmp_path)] == ["a.h5", "a.mat", "b"]
    with pytest.raises(UsageError, match="two files of one name"):
        folders_for([tmp_path / "x" / "a.h5", tmp_path / "y" / "a.h5"], tmp_path)
    assert files_of([tmp_path / ".hidden.h5", tmp_path / "a.h5"])[0].name == ".hidden.h5"  # it was named
    with pytest.raises(UsageError, match=r"archive\.json: is a file of every archive"):
        folders_for([tmp_path / "archive.json.h5", tmp_path / "a.h5"], tmp_path)
    (tmp_path / "none").mkdir()
    (tmp_path / "none" / "._run.h5").touch()  # as macOS leaves it beside a file that was taken away
    with pytest.raises(UsageError, match="holds no scans"):
        files_of([tmp_path / "none"])


def test_a_cluster_gives_each_file_its_outcome_though_a_worker_dies(tmp_path: Path) -> None:
    count = 95 if SOAK else 4
    archive(tmp_path / "in", count)
    with dask(tmp_path, port := free_port(), 2) as (_, crew):
        first = threading.Event()

        def kill_one() -> None:
            while not list((tmp_path / "out").glob("*/depth.png")):
                time.sleep(0.02)
            crew[0].send_signal(signal.SIGKILL)
            first.set()

        threading.Thread(target=kill_one, daemon=True).start()
        done = nlos(tmp_path, "reconstruct", "in", "-o", "out", "--scheduler", f"tcp://127.0.0.1:{port}")
        assert first.is_set()
    assert done.returncode == 7, done.stderr
    rows = record(tmp_path / "out")
    assert sum(row["outcome"] == "done" for row in rows.values()) == count
    assert sum(row["outcome"] == "failed" for row in rows.values()) == 5
    assert command.nlos(tmp_path, "reconstruct", "in", "-o", "here").returncode == 7
    for number in range(count):
        name = f"good_{number:03d}"
        assert np.array_equal(albedo(tmp_path / "out" / name), albedo(tmp_path / "here" / name))


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="half a minute: make soak")
def test_a_scheduler_that_dies_is_said_so_and_nothing_is_lost(tmp_path: Path) -> None:
    count = 20 if SOAK else 6
    archive(tmp_path / "in", count, points=32, bins=256)
    with dask(tmp_path, port := free_port(), 1) as (scheduler, _):

        def kill_it() -> None:
            while len(list((tmp_path / "out").glob("*/depth.png"))) < 2:
                time.sleep(0.02)
            scheduler.send_signal(signal.SIGKILL)

        threading.Thread(target=kill_it, daemon=True).start()
        done = nlos(tmp_path, "reconstruct", "in", "-o", "out", "--scheduler", f"tcp://127.0.0.1:{port}")
    assert done.returncode == 9, done.stderr
    assert f"the scheduler tcp://127.0.0.1:{port} is gone" in done.stderr
    assert "Traceback" not in done.stderr
    rows = record(tmp_path / "out")
    assert len(rows) == count + 5
    assert {row["outcome"] for row in rows.values()} >= {"unfinished"}
    kept = {name for name, row in rows.items() if row["outcome"] == "done"}
    before = times(tmp_path / "out")
    with dask(tmp_path, port := free_port(), 1):
        again = nlos(
            tmp_path, "reconstruct", "in", "-o", "out", "--skip-existing", "--scheduler", f"tcp://127.0.0.1:{port}"
        )
    assert again.returncode == 7, again.stderr
    after = times(tmp_path / "out")
    assert len(after) == count
    assert all(after[name] == before[name] for name in kept)


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="half a minute: make soak")
@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C goes to a process group")
def test_ctrl_c_at_workers_of_ones_own_keeps_what_is_done_and_leaves_no_process(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    archive(tmp_path / "in", 60, points=16, bins=128)
    (tmp_path / "at_once.py").write_text(
        "import sys\n"
        "if __name__ == '__main__':\n"
        "    import nlos.cli.archive_on_this_machine\n"
        "    from nlos.__main__ import main\n"
        "    nlos.cli.archive_on_this_machine.STARTUP_S = 0.0\n"
        "    sys.argv = 'nlos reconstruct in -o out --no-volume --scheduler local'.split()\n"
        "    main()\n"
    )
    with subprocess.Popen(
        [sys.executable, "at_once.py"], cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        deadline = time.monotonic() + 120
        while len(list((tmp_path / "out").glob("*/depth.png"))) < 12 and time.monotonic() < deadline:
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        said = process.communicate(timeout=240)[1]
    assert process.returncode == 130, said
    assert "interrupted: " in said.splitlines()[-1]
    assert "Traceback" not in said
    assert "distributed" not in said
    deadline = time.monotonic() + 10  # what read files for a worker ends with it
    while any_left(process.pid):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    rows = record(tmp_path / "out")
    assert len(rows) == 65
    known = {name for name, row in rows.items() if row["outcome"] == "done"}
    assert known
    assert known == set(times(tmp_path / "out")), "what workers had begun was waited for"
    assert "unfinished" in {row["outcome"] for row in rows.values()}


def test_a_worker_started_here_leaves_ctrl_c_to_the_command() -> None:
    before = signal.getsignal(signal.SIGINT)
    try:
        dask_setup(None)  # type: ignore[arg-type]
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_no_scheduler_is_a_deadline_passed(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    for number in range(2):
        scan(tmp_path / f"{number}.h5", number)
    done = nlos(tmp_path, "reconstruct", "0.h5", "1.h5", "-o", "out", "--scheduler", f"tcp://127.0.0.1:{free_port()}")
    assert done.returncode == 9
    assert "no Dask scheduler answers" in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_address_that_is_none_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    for address in ("tcp://127.0.0.1", "127.0.0.1:many", "tcp://:8786"):
        with pytest.raises(UsageError, match="tcp://HOST:PORT is expected"), connected(address):
            pass


def test_an_encrypted_scheduler_needs_certificates() -> None:
    dask = pytest.importorskip("dask", reason="the `cluster` extra is not installed")
    with socket.socket() as door, dask.config.set({"distributed.comm.tls.ca-file": None}):
        door.bind(("127.0.0.1", 0))
        door.listen()
        address = f"tls://127.0.0.1:{door.getsockname()[1]}"
        with pytest.raises(UsageError, match="names no certificates"), connected(address):
            pass


def test_small_archives_need_no_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        archive_on_this_machine, "STARTUP_S", 600.0
    )  # a machine that does much else reconstructs slowly
    files = [scan(tmp_path / f"{number}.h5", number) for number in range(4)]
    tasks = [Task(str(file), file, Recipe("lct"), ResultsFolder(tmp_path / "out" / file.stem)) for file in files]
    rows = reconstruct_archive(tasks, tmp_path / "out", "local").rows
    assert {row["worker"].rpartition(":")[2] for row in rows} == {str(os.getpid())}
    with pytest.raises(FileExistsError):
        reconstruct_archive(tasks, tmp_path / "out", None)
    (tmp_path / "0.h5").write_bytes(b"")
    rows = reconstruct_archive(tasks, tmp_path / "out", None, overwrite=True).rows
    assert [row["outcome"] for row in rows] == ["failed", "done", "done", "done"]
    assert worst([row for row in rows if row["code"]]) == 7


def test_the_files_of_a_worker_are_read_by_one_child(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the `cluster` extra is not installed")
    from nlos.cli import archive_on_dask

    tasks = [
        Task(str(n), scan(tmp_path / f"{n}.h5", n), Recipe("lct"), ResultsFolder(tmp_path / "out" / str(n)))
        for n in (1, 2)
    ]
    readers = []
    for task in tasks:
        assert archive_on_dask.attempt_on_worker(task).outcome == "done"
        readers.append(archive_on_dask._of_thread.reader._child.pid)
    assert readers[0] == readers[1]
    archive_on_dask._of_thread.reader.close()
    del archive_on_dask._of_thread.reader

"""Memory and processor time that a batch system or a container leaves, from files as Linux writes them."""

from pathlib import Path

import pytest

from nlos.recon.control_group import bytes_left, granted

GIB = 1 << 30


def group(folder: Path, limit: str, used: int, cached: int, version: int = 2) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    names = ("memory.max", "memory.current") if version == 2 else ("memory.limit_in_bytes", "memory.usage_in_bytes")
    (folder / names[0]).write_text(f"{limit}\n")
    (folder / names[1]).write_text(f"{used}\n")
    total, once = "" if version == 2 else "total_", cached // 4
    kept = f"{total}inactive_file {once}\n{total}active_file {cached - once}\n"
    (folder / "memory.stat").write_text(f"anon {used - cached}\nfile {cached}\n{kept}")


@pytest.fixture
def of_process(tmp_path: Path) -> Path:
    return tmp_path / "cgroup"


def test_a_job_of_a_batch_system(tmp_path: Path, of_process: Path) -> None:
    """Its limit is on the job; the group of the step within it has none, and the root has no such file at all."""
    of_process.write_text("0::/system.slice/slurmstepd.scope/job_7/step_0/user/task_0\n")
    job = tmp_path / "system.slice/slurmstepd.scope/job_7"
    group(job, str(4 * GIB), 3 * GIB, 0)
    group(job / "step_0/user/task_0", "max", GIB, 0)
    assert bytes_left(tmp_path, of_process) == GIB


def test_what_is_only_kept_of_files_is_given_back(tmp_path: Path, of_process: Path) -> None:
    """A recording of 3 GiB that was just read, most of it twice, fills a container of 4, and leaves 3.5 of them."""
    of_process.write_text("0::/\n")
    group(tmp_path, str(4 * GIB), 7 * GIB // 2, 3 * GIB)
    assert bytes_left(tmp_path, of_process) == 7 * GIB // 2


def test_the_first_version_beside_the_second(tmp_path: Path, of_process: Path) -> None:
    of_process.write_text("9:name=systemd:/\n5:cpu,cpuacct:/x\n4:memory:/jobs/7\n0::/\n")
    group(tmp_path / "memory", str((1 << 63) - 4096), 9 * GIB, 0, version=1)
    group(tmp_path / "memory/jobs/7", str(2 * GIB), GIB, GIB // 4, version=1)
    assert bytes_left(tmp_path, of_process) == 5 * GIB // 4


def test_no_limit_anywhere(tmp_path: Path, of_process: Path) -> None:
    assert bytes_left(tmp_path, of_process) is None
    of_process.write_text("0::/user.slice\n")
    assert bytes_left(tmp_path, of_process) is None
    group(tmp_path / "user.slice", "max", GIB, 0)
    assert bytes_left(tmp_path, of_process) is None


@pytest.mark.parametrize(
    ("told", "limit", "stat", "left"),
    [
        (b"0::/../../x\n", b"4096", b"active_file 1", 3073),  # moved out of what is to be seen of here
        (b"0::/a\xff\n", b"4096", b"active_file 1", 3073),
        (b"0::/a\n", b"4096", b"active_file many", 3072),
        (b"0::/a\n", b"4096", b"\xff", 3072),
        (b"0::/a\n", b"4096", b"active_file 99999", 4096),
        (b"0::/a\n", "\u00b2".encode(), b"", None),
        (b"0::/a\n", b"\xff", b"", None),
        (b"0::/a\n", b"", b"", None),
        (b"nothing that Linux writes\n", b"4096", b"", None),
    ],
)
def test_odd_names_and_contents_end_nothing(
    tmp_path: Path, of_process: Path, told: bytes, limit: bytes, stat: bytes, left: int | None
) -> None:
    of_process.write_bytes(told)
    for name, held in (("memory.max", limit), ("memory.current", b"1024"), ("memory.stat", stat)):
        (tmp_path / name).write_bytes(held)
    assert bytes_left(tmp_path, of_process) == left


@pytest.mark.parametrize(
    ("of_process", "files", "processors"),
    [
        ("0::/a/b\n", {"a/cpu.max": "100000 100000", "a/b/cpu.max": "max 100000"}, 1),
        ("0::/a/b\n", {"a/cpu.max": "250000 100000", "a/b/cpu.max": "350000 100000"}, 3),  # 2.5, begun ones whole
        ("0::/\n", {"cpu.max": "50000 100000"}, 1),  # as a container sees its own
        ("0::/\n", {"cpu.max": "400000 100000"}, None),  # as many as there are
        ("0::/\n", {"cpu.max": "max 100000"}, None),
        ("0::/\n", {"cpu.max": "much"}, None),
        ("0::/\n", {}, None),
        ("3:cpu,cpuacct:/x\n0::/\n", {"cpu/x/cpu.cfs_quota_us": "150000", "cpu/x/cpu.cfs_period_us": "100000"}, 2),
        ("3:cpu,cpuacct:/x\n0::/\n", {"cpu/x/cpu.cfs_quota_us": "-1", "cpu/x/cpu.cfs_period_us": "100000"}, None),
        ("3:cpu,cpuacct:/x\n0::/\n", {"cpu/x/cpu.cfs_quota_us": "50000", "cpu/x/cpu.cfs_period_us": "0"}, None),
        ("nothing that Linux writes\n", {"cpu.max": "50000 100000"}, None),
    ],
)
def test_processors_that_a_share_of_their_time_grants(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, of_process: str, files: dict[str, str], processors: int | None
) -> None:
    monkeypatch.setattr("nlos.recon.control_group._allowed", lambda: 4)
    (told := tmp_path / "cgroup").write_text(of_process)
    for name, held in files.items():
        (path := tmp_path / "mounted" / name).parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{held}\n")
    assert granted(tmp_path / "mounted", told) == processors

"""What outlasts a program is kept in one place, whichever folder a command is run from."""

from pathlib import Path

import pytest

from nlos.drivers.state_folder import STATE, state_folder
from nlos.series.carry_out import Series
from nlos.series.sweep import load_queue
from tests.command import nlos


@pytest.mark.parametrize("named", ["state", "./state", "~/state"])
def test_a_folder_that_depends_on_where_one_is_is_refused(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(STATE, named)
    with pytest.raises(FileNotFoundError, match=f"{STATE}={named}: is no whole path.*{STATE}=/"):
        state_folder()


def test_unset_and_empty_are_the_home_folder_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(STATE)
    expected = Path.home() / ".local" / "state" / "nlos"
    assert state_folder() == expected
    monkeypatch.setenv(STATE, "")
    assert state_folder() == expected


def test_no_scan_begins_that_would_not_know_of_a_trip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan = Path(__file__).parents[2] / "configs" / "scan" / "demo.yaml"
    monkeypatch.setenv(STATE, "state")
    done = nlos(tmp_path, "scan", str(scan), "-o", "run.h5")
    assert (done.returncode, "NLOS_STATE=state: is no whole path" in done.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []


def test_a_user_without_a_home_is_told_and_no_scan_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user number that no name belongs to, as containers have it: asked of the system's own list of users."""
    pwd = pytest.importorskip("pwd")
    number = next(free for free in range(54321, 60000) if all(free != one.pw_uid for one in pwd.getpwall()))
    for name in (STATE, "NLOS_CONFIG", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.getuid", lambda: number)
    scan = Path(__file__).parents[2] / "configs" / "scan" / "demo.yaml"
    done = nlos(tmp_path, "scan", str(scan), "-o", "run.h5")
    assert (done.returncode, f"Set {STATE}=/WHOLE/PATH, or HOME." in done.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setenv(STATE, str(tmp_path))
    assert nlos(tmp_path, "plan", str(scan)).returncode == 0


def test_an_empty_home_is_none_and_not_the_root_of_all_folders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(STATE)
    monkeypatch.setenv("HOME", "")
    with pytest.raises(FileNotFoundError, match="no home folder: HOME is empty"):
        state_folder()


def test_a_home_that_depends_on_where_one_is_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(STATE)
    monkeypatch.setenv("HOME", "somewhere")
    with pytest.raises(FileNotFoundError, match=r"HOME=somewhere: is no whole path.*HOME=/"):
        state_folder()


def test_the_home_of_nobody_is_a_wrong_word_and_one_s_own_is_found_beside_a_queue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    bench = (Path(__file__).parents[2] / "configs" / "bench" / "simulated.yaml").read_text()
    (tmp_path / "bench.yaml").write_text(bench + 'runs: {folder: "~no-such-user/data"}\n')
    (tmp_path / "queue.yaml").write_text('folder: "~/series"\nruns: [{scan: demo}]\n')
    for words in (("scan", "demo", "--bench", "bench.yaml"), ("methods", "~no-such-user/mine.py")):
        done = nlos(tmp_path, *words)
        assert (done.returncode, "~no-such-user" in done.stderr) == (2, True)
    assert Series.of(load_queue(tmp_path / "queue.yaml")).folder == tmp_path / "home" / "series"

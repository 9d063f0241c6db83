"""What outlasts a program is kept in one place, whichever folder a command is run from."""

from pathlib import Path

import pytest

from nlos.drivers.state_folder import STATE, state_folder
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

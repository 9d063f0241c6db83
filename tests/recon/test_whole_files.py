"""Files that appear together: what is left of them where the program is ended while it writes them."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nlos.recon.whole_files import whole_files

WRITES = """
import sys, time
from pathlib import Path
from nlos.recon.whole_files import whole_files

with whole_files(Path(sys.argv[1])) as partial:
    (partial / "picture.png").write_bytes(b"half")
    print("writing", flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("there_before", [False, True])
def test_sigterm_while_files_are_written_leaves_what_was_there(tmp_path: Path, there_before: bool) -> None:
    folder = tmp_path / "made"
    if there_before:
        folder.mkdir()
        (folder / "picture.png").write_bytes(b"whole")
    with subprocess.Popen([sys.executable, "-c", WRITES, str(folder)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
        writer.send_signal(signal.SIGTERM)
        assert writer.wait(30) == 128 + signal.SIGTERM
    assert [path.name for path in tmp_path.rglob("*")] == (["made", "picture.png"] if there_before else [])
    assert not there_before or (folder / "picture.png").read_bytes() == b"whole"


def test_what_a_killed_process_of_the_same_number_left_is_in_nobodys_way(tmp_path: Path) -> None:
    """In a container every run may have the same one."""
    (tmp_path / f".{os.getpid()}.part").mkdir()
    with whole_files(tmp_path) as first, whole_files(tmp_path) as second:
        (first / "albedo.png").write_text("first")
        (second / "depth.png").write_text("second")
    assert {path.name for path in tmp_path.glob("*.png")} == {"albedo.png", "depth.png"}


def test_of_two_programs_that_end_at_once_one_has_all_its_files_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(folder: Path, word: str) -> None:
        for name in ("albedo.png", "depth.png"):
            (folder / name).write_text(word)

    def both_write(folder: Path) -> None:
        with whole_files(folder, new=True) as mine, whole_files(folder, new=True) as others:
            write(mine, "mine")
            write(others, "another's")

    for knows_links in (True, False):
        folder = tmp_path / str(knows_links)
        if not knows_links:
            monkeypatch.setattr(os, "link", lambda *given: (_ for _ in ()).throw(PermissionError("no links")))
        with pytest.raises(FileExistsError, match=r"albedo\.png: exists by now: another program has made it"):
            both_write(folder)
        assert {path.name: path.read_text() for path in folder.iterdir()} == {
            "albedo.png": "another's", "depth.png": "another's"
        }  # fmt: skip
        with whole_files(folder) as again:
            write(again, "again")
        assert (folder / "depth.png").read_text() == "again"

"""What a page cannot show is refused before anybody is told where to look; what is not there yet is waited for."""

import json
import os
import shutil
import signal
import socket
import subprocess
import time
import urllib.request
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from nlos.__main__ import run
from nlos.acquisition.recording import follow
from nlos.live.process import SOCKET, TOKEN
from tests.nlos.conftest import SMALL, Viewer


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording, its results, its bench's constants, and a recording of another bench."""
    folder, before = tmp_path_factory.mktemp("taken"), Path.cwd()
    (folder / "scan.yaml").write_text(SMALL)
    os.chdir(folder)
    try:
        for words in (
            ["scan", "scan.yaml", "-o", "run.h5"],
            ["reconstruct", "run.h5", "-o", "seen"],
            ["calibrate", "run.h5", "-o", "constants.h5"],
            ["scan", "scan.yaml", "-o", "other.h5", "--bench", "optotune"],
        ):
            assert run([*words, "-q"]) == 0
    finally:
        os.chdir(before)
    return folder


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            ["plain.h5"],
            7,
            "plain.h5: is not a recording, or its beginning is damaged. `nlos import plain.h5 -o RUN.h5`",
        ),
        (["scan.yaml"], 7, "scan.yaml: is not a recording"),
        (["empty.h5"], 7, "empty.h5: is not a recording"),
        (
            ["seen/reconstruction.h5"],
            7,
            "is a reconstruction, not a recording. Name the recording that it was made from",
        ),
        (["seen"], 2, "seen: is a folder. Name a file in it"),
        (["run.h5", "plain.h5"], 7, "plain.h5: is not a recording"),
        (["run.h5", "seen"], 2, "seen: is a folder"),
        (["run.h5", "run.h5"], 2, "run.h5: is named twice. Name it once"),
        (["run.h5", "other.h5", "./other.h5", "other.h5"], 2, "other.h5: is named twice"),
        (["run.h5", "seen/../run.h5"], 2, "seen/../run.h5: and run.h5 are the same recording"),
        (["a.h5", "b.h5", "c.h5", "d.h5", "e.h5"], 2, "5 RUNs: a page shows up to 4"),
        (["run.h5", "--constants", "gone.h5"], 2, "gone.h5: no such file"),
        (["later.h5", "--constants", "plain.h5"], 7, "plain.h5: not a constants file"),
        (["other.h5", "--constants", "constants.h5"], 7, "mirror"),
        (["run.h5", "other.h5", "--constants", "constants.h5"], 7, "mirror"),
    ],
)
def test_what_no_page_can_show_is_refused_without_an_address(
    taken: Path, plain: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    words: list[str], code: int, said: str,
) -> None:  # fmt: skip
    shutil.copytree(taken, plain.parent, dirs_exist_ok=True)
    (plain.parent / "empty.h5").touch()
    monkeypatch.chdir(plain.parent)
    assert run(["live", *words, "--method", "lct", "--idle-s", "0"]) == code
    told = capsys.readouterr()
    assert said in told.err
    assert "http" not in told.out + told.err


def test_a_scan_that_has_not_begun_is_waited_for_under_its_address(
    taken: Path, tmp_path: Path, viewing: Callable[..., AbstractContextManager[Viewer]]
) -> None:
    with viewing("later.h5", "--method", "lct") as viewer:
        assert viewer.state()["status"] == "waiting"
        subprocess.run(["cp", taken / "run.h5", tmp_path / "later.h5"], check=True, timeout=240)
        assert viewer.waits(lambda state: state["over"])["samples"] == 16
    assert "waiting for later.h5" in viewer.errors.read_text()
    assert "calibrated: no plane wall" not in viewer.errors.read_text()  # a rehearsal's scan of a wall is nobody's


def test_the_page_of_a_scan_says_that_the_recording_was_gone_before_it_was_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(follow, "LEFT_ALONE_S", 0.0)
    door = socket.create_server(("127.0.0.1", 0))
    address = f"http://127.0.0.1:{door.getsockname()[1]}/word/state"
    monkeypatch.setenv(SOCKET, str(door.detach()))
    monkeypatch.setenv(TOKEN, "word")

    def asked() -> dict[str, Any]:
        while True:
            with urllib.request.urlopen(address, timeout=240) as answer:
                state: dict[str, Any] = json.load(answer)["scans"][0]
            if state["status"] != "waiting":
                os.kill(os.getpid(), signal.SIGINT)  # the viewer is there: it answered
                return state
            time.sleep(0.02)

    with ThreadPoolExecutor(1) as pool:
        said = pool.submit(asked)
        assert run(["live", "gone.h5", "--method", "lct", "--idle-s", "600", "-q"]) == 6
        assert said.result()["status"] == "missing"
    assert "gone.h5: was deleted or moved before it was opened here" in said.result()["message"]

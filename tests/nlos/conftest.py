"""Commands in a fresh folder, small scans for them, and viewers in processes of their own."""

import base64
import http.client
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import h5py
import numpy as np
import pytest

from nlos.cli.terminal import terminal
from tests import command

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

SMALL = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 4, cols: 4}
pattern: serpentine
dwell_ms: 2
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""


@pytest.fixture(autouse=True)
def nothing_asked_of_the_terminal() -> None:
    """A test before may have run a command with `-v` in this process."""
    terminal.begin()


@pytest.fixture
def nlos(tmp_path: Path) -> Nlos:
    """Runs `nlos ARGUMENTS` in a fresh folder, within this process."""
    return partial(command.nlos, tmp_path)


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scan of 4 x 4 points."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A plain HDF5 scan of 3 x 4 points."""
    path = tmp_path / "plain.h5"
    with h5py.File(path, "w") as file:
        file["histograms"] = np.random.default_rng(0).poisson(1.0, (3, 4, 64)).astype(np.uint16)
        file.attrs.update({"bin_width_s": 4e-12, "wall_size_m": [0.7, 0.5], "direct_cut_bins": 3})
    return path


@dataclass
class Viewer:
    """A viewer in a process of its own, and what its page answers."""

    url: str
    process: "subprocess.Popen[str]"
    errors: Path

    @staticmethod
    def array(packed: dict[str, Any]) -> "np.ndarray[Any, np.dtype[np.float32]]":
        """What the page's script unpacks."""
        return np.frombuffer(base64.b64decode(packed["f4"]), dtype="<f4").reshape(packed["shape"])

    def get(self, path: str, method: str = "GET", host: str | None = None) -> tuple[int, bytes, dict[str, str]]:
        """Status, body and headers."""
        there = urlsplit(self.url)
        connection = http.client.HTTPConnection("127.0.0.1", there.port or 0, timeout=30)
        for left in (2, 1, 0):  # as the page does
            try:
                connection.request(method, path, headers={"Host": host or there.netloc})
                answer = connection.getresponse()
                break
            except ConnectionError:
                connection.close()
                if not left:
                    raise
                time.sleep(0.35)
        got = answer.status, answer.read(), {key.lower(): value for key, value in answer.getheaders()}
        connection.close()
        return got

    def ask(self, what: str) -> dict[str, Any]:
        status, body, _ = self.get(urlsplit(self.url).path + what)
        assert status == 200, body
        found = json.loads(body)
        assert isinstance(found, dict)
        return found

    def state(self, scan: int = 0) -> dict[str, Any]:
        found = self.ask("state")["scans"][scan]
        assert isinstance(found, dict)
        return found

    def waits(self, until: Callable[[dict[str, Any]], Any], seconds: float = 90, scan: int = 0) -> dict[str, Any]:
        """The first state of that scan of which `until` holds."""
        deadline_s = time.monotonic() + seconds
        while not until(state := self.state(scan)):
            assert time.monotonic() < deadline_s, state
            time.sleep(0.1)
        return state


@contextmanager
def _viewing(folder: Path, *words: str, ends: int | None = 130) -> Iterator[Viewer]:
    errors = folder / "viewer.log"
    with errors.open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "nlos", "live", *words], cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True
        )
    assert process.stdout is not None
    try:
        yield Viewer(process.stdout.readline().strip(), process, errors)
        if ends is not None:
            process.send_signal(signal.SIGINT)
            assert process.wait(240) == ends
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def viewing(tmp_path: Path) -> Callable[..., AbstractContextManager[Viewer]]:
    """`nlos live WORDS` in the fresh folder, ended by Ctrl-C with exit code `ends`; None: it ends by itself."""

    def view(*words: str, ends: int | None = 130) -> AbstractContextManager[Viewer]:
        return _viewing(tmp_path, *words, ends=ends)

    return view

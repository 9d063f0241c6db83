"""A process that runs commands one after the other, and says what each of them left behind in it."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.nlos.strangers.kinds_of_files import make, verbs_of

HANG = -14


@dataclass(frozen=True)
class Outcome:
    """`code`: the exit code, `HANG` after the deadline, another negative number for a signal."""

    words: tuple[str, ...]
    code: int
    text: str
    left: tuple[str, ...] = ()
    """Descriptors, threads and processes that were not there before."""

    @property
    def is_a_bug(self) -> bool:
        return self.code < 0 or self.code == 1 or "Traceback" in self.text or bool(self.left)


class CommandProcess:
    """The process that runs them; it is restarted after a command that ended it."""

    def __init__(self, folder: Path, deadline_s: float = 60.0) -> None:
        self._folder, self._deadline_s = folder, deadline_s
        self._process: subprocess.Popen[str] | None = None

    def run(self, words: Sequence[str]) -> Outcome:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-P", str(Path(__file__).with_name("command_process.py")), str(self._deadline_s)],
                cwd=self._folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                start_new_session=True,
            )  # fmt: skip
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(list(words)) + "\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            self._process = None
            os.killpg(process.pid, signal.SIGKILL)
            return Outcome(tuple(words), process.wait(), "")
        code, text, left = json.loads(line)
        return Outcome(tuple(words), code, text, tuple(left))

    def close(self) -> None:
        if self._process is not None:
            self._process.communicate("", timeout=240)
            self._process = None


@pytest.fixture
def kinds(tmp_path: Path) -> dict[str, Path]:
    """Kind -> a good file of it, in the test's folder."""
    return make(tmp_path)


@pytest.fixture
def verbs() -> Callable[[str], tuple[tuple[str, ...], ...]]:
    """Kind -> the commands that read it."""
    return verbs_of


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[CommandProcess]:
    """A process that runs commands in the test's folder."""
    process = CommandProcess(tmp_path)
    yield process
    process.close()

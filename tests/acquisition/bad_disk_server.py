"""Commands on a disk that goes bad, each in a fork of a process that has loaded what they need."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

HERE = Path(__file__).parent
Run = Callable[..., int | None]


def built_shim(folder: Path) -> Path:
    """`bad_disk.so`, built in `folder`: what is loaded before the C library."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("a disk that goes bad needs Linux and a C compiler (apt-get install gcc)")
    shim = folder / "bad_disk.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", shim, HERE / "bad_disk.c", "-ldl"], check=True)
    return shim


@contextmanager
def bad_disks(folder: Path) -> Iterator[Run]:
    """run(folder, bad, *arguments): a command on a disk that goes bad (`bad_disk.c`); its exit code, or minus the
    signal that ended it. The shim is built in `folder`."""
    shim = built_shim(folder)
    runs = subprocess.Popen(
        [sys.executable, HERE / "bad_disk_runs.py"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "LD_PRELOAD": str(shim)},
    )  # fmt: skip
    assert runs.stdin is not None
    assert runs.stdout is not None
    ask, answers = runs.stdin, runs.stdout

    def run(folder: Path, bad: str, *arguments: str) -> int | None:
        ask.write(json.dumps({"bad": bad, "arguments": arguments, "folder": str(folder)}) + "\n")
        ask.flush()
        code: int | None = json.loads(answers.readline())["code"]
        return code

    try:
        yield run
    finally:
        ask.close()
        runs.wait(240)
        answers.close()

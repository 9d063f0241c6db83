"""Code that nobody here wrote, at the other end of our drivers: where it lies, and why a test is skipped without it.

`NLOS_PEERS=DIR make peers`; `docs/peers.md` says what DIR holds.
"""

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

HOW = "docs/peers.md says how to get it"


@pytest.fixture(scope="session")
def peers() -> Path:
    """The folder of checkouts and of the environment `env`."""
    folder = os.environ.get("NLOS_PEERS")
    if not folder:
        pytest.skip(f"NLOS_PEERS names no folder; {HOW}")
    path = Path(folder).expanduser().resolve()
    if not path.is_dir():
        pytest.fail(f"NLOS_PEERS={folder} is not a folder; {HOW}")
    return path


@pytest.fixture(scope="session")
def checkout(peers: Path) -> Callable[..., Path]:
    """checkout("tinyusb", "src/class/usbtmc"): that part of a checkout."""

    def find(name: str, part: str = "") -> Path:
        path = peers / name / part
        if not path.exists():
            pytest.skip(f"{path.relative_to(peers.parent)} is absent; {HOW}")
        return path

    return find


@pytest.fixture(scope="session")
def foreign_python(peers: Path) -> Callable[..., Path]:
    """foreign_python("snapi", "pyvisa_py"): the interpreter of the environment that has these packages."""

    def find(*modules: str) -> Path:
        python = peers / "env/bin/python"
        if not python.exists():
            pytest.skip(f"{python.relative_to(peers.parent)} is absent; {HOW}")
        for module in modules:
            if subprocess.run([python, "-c", f"import {module}"], capture_output=True).returncode:
                pytest.skip(f"{module} is not installed in {peers.name}/env; {HOW}")
        return python

    return find


@pytest.fixture(scope="session")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """compiled("v4b", ["core.cpp", ...], ["-I..."]): the program or, with `-shared` among the flags, library."""
    folder = tmp_path_factory.mktemp("compiled")

    def build(
        name: str,
        sources: Sequence[str | Path],
        flags: Sequence[str | Path] = (),
        compiler: str = "g++",
        before: Sequence[str | Path] = (),
    ) -> Path:
        if shutil.which(compiler) is None:
            pytest.skip(f"no {compiler} on this machine")
        output = folder / name
        if not output.exists():
            command = [compiler, "-O1", "-w", *map(str, (*before, *sources, *flags)), "-o", str(output)]
            done = subprocess.run(command, capture_output=True, text=True)
            assert done.returncode == 0, f"{' '.join(command)}\n{done.stderr[:4000]}"
        return output

    return build

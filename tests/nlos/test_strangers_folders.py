"""A folder of other people's files is looked at, never run: neither this process nor a child of it imports from it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import arrays_of_import
from nlos.acquisition.importers.formats import read_any

PACKAGES = ("h5py", "numpy", "scipy", "ptufile", "torch", "safetensors", "matplotlib", "pydantic", "yaml", "rich",
            "typer", "click", "serial", "usb", "uvicorn", "starlette", "zmq", "distributed", "calibration",
            "recon")  # fmt: skip
FOLDERS = ("drivers", "configs", "acquisition", "live")
NLOS = Path(sys.executable).with_name("nlos")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Full of names that this program imports; each leaves a file beside it when it is run."""
    code = "import pathlib\npathlib.Path({!r}).touch()\nraise SystemExit('a file of this folder was run')\n"
    for name in {*PACKAGES, *sys.stdlib_module_names} - {"pathlib"}:
        (tmp_path / f"{name}.py").write_text(code.format(str(tmp_path / f"{name}.ran")))
    for name in FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(code.format(str(tmp_path / f"{name}.ran")))
    return tmp_path


@pytest.fixture
def ptu(folder: Path, plain: Path) -> Path:
    write_ptu(arrays_of_import(read_any(plain), plain), folder / "scan.ptu")
    return folder / "scan.ptu"


def ran(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.ran"))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("words", [("info", "scan.ptu"), ("import", "scan.ptu", "-o", "run.h5"),
                                   ("reconstruct", "plain.h5", "--method", "backprojection")])  # fmt: skip
def test_the_command_runs_nothing_of_the_folder(folder: Path, ptu: Path, words: tuple[str, ...]) -> None:
    done = subprocess.run([NLOS, *words], cwd=folder, capture_output=True, text=True, timeout=240)
    assert (done.returncode, ran(folder)) == (0, []), done.stderr


def test_neither_does_python_m(folder: Path, ptu: Path) -> None:
    for name in sys.stdlib_module_names:  # what Python itself imports before this program begins is not ours to refuse
        (folder / f"{name}.py").unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-m", "nlos", "info", "scan.ptu"], cwd=folder, capture_output=True, text=True, timeout=240
    )
    assert (done.returncode, ran(folder)) == (0, []), done.stderr


@pytest.mark.parametrize(
    "program",
    [
        "from nlos.acquisition.importers.isolated import read_isolated; read_isolated(Path('scan.ptu'))",
        "from nlos.recon.weights.foreign import read_foreign; read_foreign(Path('weights.pt'))",
    ],
)
def test_nor_the_children_of_a_notebook(folder: Path, ptu: Path, program: str) -> None:
    torch.save({"state_dict": {"a": torch.ones(2)}}, folder / "weights.pt")
    done = subprocess.run(
        [sys.executable, "-P", "-c", f"from pathlib import Path; {program}"],
        cwd=folder, capture_output=True, text=True, timeout=240,
    )  # fmt: skip
    assert (done.returncode, ran(folder)) == (0, []), done.stderr


def test_the_live_page_of_a_scan_runs_nothing_either(folder: Path, small: Path) -> None:
    done = subprocess.run(
        [NLOS, "scan", small.name, "-o", "run.h5", "--live", "--json"], cwd=folder, capture_output=True, text=True,
        timeout=240,
    )  # fmt: skip
    os.kill(json.loads(done.stdout)["live"]["pid"], signal.SIGTERM)  # the page outlives the scan
    assert (done.returncode, ran(folder)) == (0, []), done.stderr

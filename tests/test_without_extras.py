"""Who installed no extra has every command that needs none: each module above the rooms is imported without them."""

import ast
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

import nlos
from tests.test_house_rules import TOP, files

EXTRAS = ("torch", "safetensors", "zmq", "tensorboard", "xarray", "distributed", "dask", "mkdocs", "IPython", "napari")

CODE = """
import importlib, sys
for name in {extras!r}:
    sys.modules[name] = None
for name in {ours!r}:
    importlib.import_module(name)
"""


def test_every_command_is_there_without_extras() -> None:
    ours = [
        file.removeprefix("src/").removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for file, _ in files()
        if file.startswith("src/nlos/") and not file.endswith("__main__.py")
    ]
    assert "nlos.cli.reconstruct" in ours
    command = [sys.executable, "-c", CODE.format(extras=EXTRAS, ours=ours)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=Path(__file__).parent)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize(("package", "name"), [("serial", "pyserial"), ("usb", "pyusb")])
def test_a_package_of_its_own_that_is_not_there_is_named(package: str, name: str) -> None:
    run = f"import sys; sys.modules[{package!r}] = None; from nlos.__main__ import run; sys.exit(run(['devices']))"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert f"pip install {name}" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_library_that_cannot_be_loaded_is_told(tmp_path: Path) -> None:
    """Of another computer, on a file system without leave to execute, or in too little memory."""
    (tmp_path / "usb").mkdir()
    (tmp_path / "usb/__init__.py").write_text("import usb._compiled", encoding="utf-8")
    (tmp_path / f"usb/_compiled{EXTENSION_SUFFIXES[0]}").touch()
    run = f"import sys; sys.path[:0] = [{str(tmp_path)!r}]; from nlos.__main__ import run; sys.exit(run(['devices']))"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "nlos: an installed library cannot be loaded (" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_doctor_reconstructs_its_scan_without_torch() -> None:
    run = "import sys; sys.modules['torch'] = None; from nlos.__main__ import run; sys.exit(run(['doctor']))"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "torch is not installed: scanning works, and of the methods fk and lct" in done.stdout
    assert "PASS  reconstruction" in done.stdout


def test_python_is_told_what_to_install_for_a_method_that_is_asked_for() -> None:
    run = """
import sys
sys.modules["torch"] = None
import numpy as np, nlos
try:
    nlos.reconstruct(np.ones((4, 4, 64)), "gram", wall=1.0, bin_width=32e-12, rectified=True)
except ModuleNotFoundError as error:
    print(error.name, error)
"""
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, timeout=120)
    assert done.stdout.startswith("torch gram needs torch"), done.stderr[-2000:]
    assert "pip install 'nlos[recon]'" in done.stdout


def test_a_type_checker_knows_the_names_that_there_are() -> None:
    """It takes a module's `__getattr__` for a name of any kind, a misspelt one among them."""
    tree = ast.parse((TOP / "src/nlos/__init__.py").read_text(encoding="utf-8"))
    defined = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    assert "__getattr__" not in defined
    with pytest.raises(AttributeError, match=r"it offers .*reconstruct"):
        _ = nlos.reconstuct  # type: ignore[attr-defined]

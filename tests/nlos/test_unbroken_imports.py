"""Ctrl-C while torch is loaded: it waits for the end of the import, unless somebody's own handler is to have it."""

import subprocess
import sys

import pytest

pytest.importorskip("torch")

LOADED = """
import os, signal, sys, time
from nlos.cli.unbroken_imports import load_libraries_unbroken

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "torch.distributed" and not came:
            came.append(name)
            os.kill(os.getpid(), signal.SIGINT)

came = []
load_libraries_unbroken()
sys.meta_path.insert(0, Finder())
HANDLER
try:
    import torch
    print("loaded", flush=True)
    time.sleep(20)
except KeyboardInterrupt:
    print(came, hasattr(sys.modules.get("torch"), "compile"))
"""
OWN = "signal.signal(signal.SIGINT, lambda number, frame: print('at once', 'torch.distributed' in sys.modules))"


def said(handler: str, words: str = "") -> list[str]:
    code = LOADED.replace("HANDLER", handler).replace("time.sleep(20)", words or "time.sleep(20)")
    child = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=100, check=False)
    assert child.stderr == ""
    return child.stdout.splitlines()


def test_it_comes_when_torch_is_whole() -> None:
    assert said("")[-1] == "['torch.distributed'] True"


def test_a_handler_of_a_bench_has_it_at_once() -> None:
    assert said(OWN, "pass") == ["at once False", "loaded"]

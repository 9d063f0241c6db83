"""The command line answers fast, loads little, and knows every verb that it names."""

import importlib
import json
import subprocess
import sys

import pytest

from nlos.app import VERBS, load_verb


def nlos(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "nlos", *arguments], capture_output=True, text=True, timeout=60)


def test_help_names_every_verb_and_loads_neither_torch_nor_h5py() -> None:
    program = (
        "import sys; from nlos.__main__ import run; code = run(['--help']);"
        "heavy = {'torch', 'h5py', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else code)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    for verb in VERBS:
        assert verb in done.stdout


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_its_file_and_its_help(verb: str) -> None:
    command = load_verb(verb)
    assert command.name == verb
    assert importlib.import_module(f"nlos.{verb}_" if verb == "import" else f"nlos.{verb}").__doc__


def test_usage_errors_exit_with_2_and_say_so_in_json() -> None:
    assert nlos("no-such-verb").returncode == 2
    assert nlos("--wire-log").returncode == 2
    done = nlos("plan", "no-such-scan", "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"]["exit_code"] == 2


def test_the_version_is_told_everywhere() -> None:
    assert nlos("scan", "--version").stdout.startswith("nlos ")

"""The command line answers fast, loads little, and knows every verb that it names."""

import errno
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from nlos.__main__ import report, run
from nlos.cli.app import VERBS, load_verb
from nlos.cli.exit_codes import exit_code
from nlos.cli.terminal import take_global_options, terminal


def nlos(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "nlos", *arguments], capture_output=True, text=True, timeout=240)


def test_help_names_every_verb_and_loads_neither_torch_nor_h5py() -> None:
    program = (
        "import sys; from nlos.__main__ import run; code = run(['--help']);"
        "heavy = {'torch', 'h5py', 'scipy', 'matplotlib', 'numpy'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else code)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    for verb in VERBS:
        assert verb in done.stdout


def test_no_verb_loads_what_only_its_work_may_need() -> None:
    """Most of a short command's time once went into loading what it never used: PyTorch, pictures, parts of SciPy."""
    program = (
        "import sys; from nlos.cli.app import VERBS, load_verb\n"
        "for verb in VERBS: load_verb(verb)\n"
        "heavy = ('torch', 'matplotlib', 'scipy.io', 'scipy.optimize', 'scipy.sparse', 'scipy.spatial')\n"
        "sys.exit(' '.join(name for name in heavy if name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=240)
    assert done.stderr.strip() == ""


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_its_file_and_its_help(verb: str) -> None:
    command = load_verb(verb)
    assert command.name == verb
    assert importlib.import_module(f"nlos.cli.{verb}_" if verb == "import" else f"nlos.cli.{verb}").__doc__


def test_usage_errors_exit_with_2_and_say_so_in_json() -> None:
    assert nlos("no-such-verb").returncode == 2
    assert nlos("--wire-log").returncode == 2
    done = nlos("plan", "no-such-scan", "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"]["exit_code"] == 2
    done = nlos("reconstruct", "--json")
    assert json.loads(done.stdout)["error"]["exit_code"] == 2


def test_verbosity_may_be_given_in_one_word() -> None:
    for word, expected in (("-vv", 2), ("-qq", -2), ("-qvv", 1), ("-q", -1)):
        assert take_global_options(["scan", word, "-o", "x"]) == (["scan", "-o", "x"], False)
        assert terminal.verbosity == expected
    terminal.begin()


def test_an_option_that_point_does_not_know_is_no_number() -> None:
    done = nlos("point", "--lihgt", "1", "0.1")
    assert done.returncode == 2
    assert "no such option: --lihgt" in done.stderr


def test_what_was_not_installed_is_named_with_the_extra_that_brings_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert report(ModuleNotFoundError("No module named 'zmq.auth'", name="zmq.auth")) == 2
    assert "pip install 'nlos[live]'" in capsys.readouterr().err
    assert exit_code(ModuleNotFoundError("No module named 'nlos.ghost'", name="nlos.ghost")) == 1


def test_an_import_error_that_says_nothing_is_told_as_any_other() -> None:
    """As a plug-in raises it by its bare name."""
    assert report(ImportError()) == 1


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["run.h5", "--method", "lctt"], 2, "there is no method 'lctt'"),
        (["run.h5", "--set", "snrr=1"], 2, "no setting 'snrr'"),
        (["run.h5", "--device", "tpu"], 2, "cpu or cuda"),
        (["a/run.h5", "b/run.h5"], 2, "two files of one name"),
        (["gone.ticket", "--follow", "-o", "new"], 2, "gone.ticket: no such file"),
        (["gone.h5"], 2, "gone.h5: no such file"),
    ],
)
def test_what_cannot_be_reconstructed_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    words: list[str], code: int, said: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert run(["reconstruct", *words]) == code
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [["scan", "demo", "-o", "run.h5", "--reconstruct", "fk"], ["queue", "queue.yaml"], ["methods", "fk"]]
)
def test_memory_that_holds_no_method_ends_nothing_as_if_a_scan_were_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    def refused(name: str) -> None:
        raise MemoryError

    (tmp_path / "queue.yaml").write_text("{runs: [{scan: demo}], reconstruct: fk}")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nlos.recon.methods.importlib", SimpleNamespace(import_module=refused))
    assert run(words) == 2
    assert "fk: the memory does not hold this method" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["queue.yaml"]


def test_the_version_is_told_everywhere() -> None:
    assert nlos("scan", "--version").stdout.startswith("nlos ")
    assert json.loads(nlos("--json", "--version").stdout) == {"version": nlos("--version").stdout.split()[1]}


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("nlos ru", "runs"), ("nlos scan dem", "demo"), ("nlos plan demo --bench mul", "multiharp"),
     ("nlos scan demo --swe", "--sweep")],
)  # fmt: skip
def test_a_shell_completes_verbs_options_scans_and_benches(typed: str, offered: str) -> None:
    asked = {"_NLOS_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    program = "import sys; sys.argv = ['nlos']; from nlos.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | asked, capture_output=True, text=True, timeout=240
    )
    assert done.stdout.split() == [offered]


def test_a_share_that_is_gone_and_a_system_that_opens_no_more_files_are_no_bugs(tmp_path: Path) -> None:
    """What sshfs and NFS say of a share whose other end went, and, by the system itself, a process out of files."""
    for number in (errno.ENOTCONN, errno.ESTALE, errno.EHOSTDOWN, errno.EXDEV, errno.EBUSY, errno.ENOLCK):
        assert exit_code(OSError(number, os.strerror(number), "/mnt/lab/run.h5")) == 6
    resource = pytest.importorskip("resource")
    (tmp_path / "run.h5").write_bytes(b"0" * 100)
    with (tmp_path / "said.txt").open("w") as said:
        child = os.fork()
        if not child:
            os.dup2(said.fileno(), 2)
            sys.stderr = os.fdopen(2, "w")
            free = os.open(os.devnull, os.O_RDONLY)
            resource.setrlimit(resource.RLIMIT_NOFILE, (free, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
            code = run(["verify", str(tmp_path / "run.h5")])
            sys.stderr.flush()
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 6, (tmp_path / "said.txt").read_text()
    assert "Too many open files" in (tmp_path / "said.txt").read_text()


def test_a_folder_that_cannot_be_made_is_told_of_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(path: Path, *given: object, **more: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    (tmp_path / "queue.yaml").write_text("runs: [{scan: demo}]")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Path, "mkdir", refused)
    assert run(["scan", "demo", "-o", "new/run.h5"]) == 6
    assert "nlos: new: Read-only file system. Choose another place with -o.\n" in capsys.readouterr().err
    assert run(["queue", "queue.yaml"]) == 6
    said = capsys.readouterr().err
    assert "nlos: queue: cannot be made (Read-only file system). Name another `folder` in queue.yaml.\n" in said

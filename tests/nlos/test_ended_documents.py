"""The document of `--json`: that a signal ended the command is in it, and any reader of JSON takes it."""

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli.terminal import Terminal
from tests.command import nlos

LONG = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 64, cols: 64}
pattern: serpentine
dwell_ms: 40
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""
COMMANDS = {
    "reconstruct": ("reconstruct run.h5 --method gradient_descent --set iterations=9999", "run.h5: gradient_descent"),
    "scan": ("scan long.yaml -o long.h5", "scheme"),
}


@pytest.mark.sampled(3)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize(
    ("verb", "number"),
    [("reconstruct", signal.SIGINT), ("reconstruct", signal.SIGTERM), ("scan", signal.SIGTERM)],
)
def test_a_document_says_that_a_signal_ended_its_command(tmp_path: Path, verb: str, number: signal.Signals) -> None:
    (tmp_path / "long.yaml").write_text(LONG)
    nlos(tmp_path, "scan", "five_by_five", "-o", "run.h5", check=True)
    words, begun = COMMANDS[verb]
    command = [sys.executable, "-P", "-m", "nlos", "--json", *words.split()]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    ) as child:
        assert child.stderr is not None
        while begun not in (line := child.stderr.readline()):
            assert line, "it ended before it began"
        while verb == "scan" and not (tmp_path / "long.h5").exists():
            assert child.poll() is None
        child.send_signal(number)
        out, said = child.communicate(timeout=240)
    error = json.loads(out)["error"]
    assert (child.returncode, error["exit_code"]) == (128 + number, 128 + number), said
    assert said.count(f"nlos: {error['message']}") == 1, said
    words_of = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
    assert "long.h5" in error["message"] if verb == "scan" else error["message"] == words_of[number]
    assert "Traceback" not in said


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("step", "calls", "status"), [("write", 1, "interrupted"), ("write", 25, "complete"), ("finish", 1, "complete")]
)
def test_a_document_says_what_a_signal_left_of_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, calls: int, status: str, number: signal.Signals
) -> None:
    """One that comes once all of its 25 points are taken changes nothing of it."""
    carry_out, called = getattr(RecordingWriter, step), 0

    def carry_out_and_be_told(writer: RecordingWriter, what: object) -> None:
        nonlocal called
        carry_out(writer, what)
        called += 1
        if called == calls:
            signal.raise_signal(number)

    monkeypatch.setattr(RecordingWriter, step, carry_out_and_be_told)
    done = nlos(tmp_path, "scan", "five_by_five", "-o", "run.h5", "--json")
    document = json.loads(done.stdout)
    if step == "finish" and number == signal.SIGINT:  # the scan was over
        assert (done.returncode, "error" in document) == (0, False), done.stderr
    else:
        assert (done.returncode, document["error"]["exit_code"]) == (128 + number, 128 + number), done.stderr
        assert ("--resume" in document["error"]["message"]) == (status == "interrupted")
    assert (document["recording"], document["status"]) == ("run.h5", status)
    monkeypatch.undo()
    again = json.loads(nlos(tmp_path, "scan", "five_by_five", "-o", "run.h5", "--json", "--resume", check=True).stdout)
    assert (again["taken"] == 0) == (status == "complete")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_a_signal_that_comes_while_python_tidies_up_prints_no_error() -> None:
    at_the_end = "import atexit, os, signal, sys; atexit.register(os.kill, os.getpid(), signal.SIGTERM); "
    verb = "sys.argv = ['nlos', '--json', 'methods']; from nlos.__main__ import main; main()"
    done = subprocess.run([sys.executable, "-P", "-c", at_the_end + verb], capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")
    assert "error" not in json.loads(done.stdout)


def test_what_is_not_finite_leaves_a_document_that_every_reader_takes(capsys: pytest.CaptureFixture[str]) -> None:
    """RFC 8259 has no NaN: of a settling beam, say, at the moments at which no light told where it was."""

    def refused(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    terminal = Terminal(as_json=True)
    terminal.result("", findings=[{"y": [0.25, math.nan, 1.0]}], rate_hz=math.inf, off={"x_m": -math.inf}, points=16)
    terminal.finish()
    found = json.loads(capsys.readouterr().out, parse_constant=refused)
    assert found == {"findings": [{"y": [0.25, None, 1.0]}], "rate_hz": None, "off": {"x_m": None}, "points": 16}

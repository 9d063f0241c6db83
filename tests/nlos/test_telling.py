"""Whoever a bench file names is told how a run ended; what fails there harms no run and takes no longer than it may."""

import json
import os
import select
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.configs.load import ConfigError, parse
from nlos.drivers.run_defaults import HookSettings, MailSettings
from nlos.telling import ALARM, DONE, Ending, tell, told
from tests.nlos.conftest import SMALL

NOTES = RunNotes.of("a $(touch harm) hat", "Ada", "with 'quotes'\nand lines", ["night", "red"])
ENDING = Ending("run.h5", ALARM, "count rate: 6e+06", 5, **asdict(NOTES))


@contextmanager
def serving(server: socketserver.BaseServer) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join(10)
        server.server_close()


def test_a_command_is_told_everything_as_text(tmp_path: Path) -> None:
    out = tmp_path / "out"
    names = " ".join(f'"$NLOS_{name}"' for name in ("RUN", "STATUS", "MESSAGE", "SAMPLE", "NOTE", "TAGS", "EXIT_CODE"))
    tell(HookSettings(alarm=f'cd {tmp_path}; printf "%s|" {names} > {out}', done="touch done"), ENDING)
    assert out.read_text() == f"run.h5|alarm|count rate: 6e+06|{NOTES.sample}|{NOTES.note}|night,red|5|"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out"]


def test_a_command_that_takes_too_long_is_ended_with_all_it_began(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = tmp_path / "held"
    os.mkfifo(held)
    reader = os.open(held, os.O_RDONLY | os.O_NONBLOCK)
    for deadline_s in (1.0, 4.0, 16.0, 64.0):  # a machine that is busy may not begin it in the first
        tell(HookSettings(alarm=f"exec 3> {held}; echo begun >&3; sleep 600 & wait", deadline_s=deadline_s), ENDING)
        assert "command of run.h5 was not told" in capsys.readouterr().err
        if select.select([reader], [], [], 0)[0] and os.read(reader, 100) == b"begun\n":
            break
    else:
        raise AssertionError("it was never begun")
    assert select.select([reader], [], [], 60)[0], "it is still held"
    assert os.read(reader, 100) == b""
    os.close(reader)
    tell(HookSettings(alarm="echo no such thing >&2; exit 3"), ENDING)
    assert "ended with 3: no such thing" in capsys.readouterr().err


def test_what_a_command_prints_is_no_part_of_a_document(capfd: pytest.CaptureFixture[str]) -> None:
    tell(HookSettings(alarm="echo aloud; echo a word >&2"), ENDING)
    assert capfd.readouterr() == ("", "")


def test_a_web_address_gets_it_as_json() -> None:
    got: list[dict[str, Any]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            got.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *args: object) -> None:
            return

    server = HTTPServer(("127.0.0.1", 0), Handler)
    with serving(server):
        tell(HookSettings(webhook=f"http://127.0.0.1:{server.server_port}/x", deadline_s=60.0), ENDING)
    assert got == [asdict(ENDING) | {"tags": ["night", "red"]}]


def test_a_mail_is_sent() -> None:
    got: list[str] = []

    class Handler(socketserver.StreamRequestHandler):
        timeout = 60

        def handle(self) -> None:
            self.wfile.write(b"220 here\r\n")
            in_letter = False
            for raw in self.rfile:
                line = raw.decode().rstrip("\r\n")
                if in_letter:
                    in_letter = line != "."
                    got.append(line)
                    if in_letter:
                        continue
                    self.wfile.write(b"250 kept\r\n")
                elif line.upper() == "DATA":
                    in_letter = True
                    self.wfile.write(b"354 go on\r\n")
                elif line.upper() == "QUIT":
                    self.wfile.write(b"221 bye\r\n")
                    return
                else:
                    self.wfile.write(b"250 yes\r\n")

    server = socketserver.TCPServer(("127.0.0.1", 0), Handler)
    with serving(server):
        port = int(server.server_address[1])
        mail = MailSettings(server="127.0.0.1", port=port, sender="lab@example.org", to=("ada@example.org",))
        tell(HookSettings(mail=mail, deadline_s=60.0), ENDING)
    letter = "\n".join(got)
    assert "Subject: nlos: alarm: run.h5" in letter
    assert "To: ada@example.org" in letter
    assert "count rate: 6e+06" in letter


def test_nobody_there_is_said_and_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    mail = MailSettings(server="127.0.0.1", port=1, sender="a@b", to=("c@d",))
    tell(HookSettings(webhook="http://127.0.0.1:1/", mail=mail, deadline_s=2.0), ENDING)
    said = capsys.readouterr().err
    assert "webhook of run.h5 was not told" in said
    assert "mail of run.h5 was not told" in said
    with pytest.raises(ConfigError, match="http://"):
        parse("webhook: file:///etc/passwd", "h.yaml", HookSettings)


@pytest.mark.parametrize(
    ("error", "status"),
    [(None, DONE), (Stopped(ExitCode.ALARM, "rate"), ALARM), (Stopped(ExitCode.INTERRUPTED, "Ctrl-C"), None),
     (KeyboardInterrupt(), None), (UsageError("no"), None), (RuntimeError("a bug"), ALARM)],
)  # fmt: skip
def test_the_right_ones_are_told(tmp_path: Path, error: BaseException | None, status: str | None) -> None:
    out = tmp_path / "out"
    hooks = HookSettings(**dict.fromkeys(("done", "alarm"), f"echo $NLOS_STATUS > {out}"))  # type: ignore[arg-type]
    with suppress(BaseException), told(hooks, Path("run.h5"), NOTES):
        if error is not None:
            raise error
    assert (out.read_text().strip() if out.exists() else None) == status


def test_a_scan_tells_when_it_is_dark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NLOS_CONFIG", str(tmp_path))
    (tmp_path / "defaults.yaml").write_text(
        "hooks: {done: 'tail -1 witness > done', alarm: 'tail -1 witness > alarm; exit 7'}\n"
    )
    bench = (Path(__file__).parents[2] / "configs/bench/simulated.yaml").read_text()
    Path("bench.yaml").write_text(bench.replace("  seed: 20260", "  seed: 20260\n  witness: witness"))
    Path("small.yaml").write_text(SMALL)
    assert run(["scan", "small.yaml", "--bench", "bench.yaml", "-o", "a.h5"]) == 0
    assert "shutter open" not in Path("done").read_text()
    Path("small.yaml").write_text(SMALL + "alarms: {pile_up: 1.0e-6}\n")
    assert run(["scan", "small.yaml", "--bench", "bench.yaml", "-o", "b.h5"]) == 5
    assert Path("alarm").exists()


@pytest.mark.parametrize(
    "answer", [b"SSH-2.0-OpenSSH_9.6\r\n", b"\xff\xfe garbage\r\n\r\n", b"HTTP/1.1 200 OK\r\nX: " + b"x" * 70_000]
)
def test_a_web_address_that_answers_badly_harms_no_run(answer: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    class Rude(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(1 << 16)
            self.request.sendall(answer)

    server = socketserver.TCPServer(("127.0.0.1", 0), Rude)
    with serving(server):
        tell(HookSettings(webhook=f"http://127.0.0.1:{server.server_address[1]}/", deadline_s=60), ENDING)
    assert "webhook of run.h5 was not told" in capsys.readouterr().err
    tell(HookSettings(webhook="http://127.0.0.1:9/a b"), ENDING)
    assert "webhook of run.h5 was not told" in capsys.readouterr().err

"""The screen in the corridor: what runs, what is to come, what was taken; for who has its address, and to look only."""

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.recording.writer_lock import WriterLock
from nlos.cli.exit_codes import UsageError
from nlos.cli.status import listening_at
from nlos.live.admission import admitted
from nlos.live.web import Refused, Request, WebServer
from nlos.series.journal import ALARM, BEGUN, DONE, FAILED, INTERRUPTED, NAME, STORAGE, Journal
from nlos.status_page import StatusPage, body
from nlos.time_of_day import shown_after
from tests.acquisition.test_recording import plan_of, sample_of
from tests.changed_bench import bench_file

TOKEN = "corridor-corridor"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A folder with a finished run, and a series: one done, one ended by an alarm, one to come."""
    folder = tmp_path / "data"
    (folder / "night").mkdir(parents=True)
    journal = Journal(folder / "night")
    journal.plan({"1-hat": 10.0, "2-cap": 10.0, "3-hut": 3600.0})
    for name, what in (("1-hat", DONE), ("2-cap", ALARM)):
        journal.add(name, BEGUN)
        journal.add(name, what, message="" if what == DONE else "too <b>bright</b>")
    return folder


def growing(path: Path, points: int) -> RecordingWriter:
    plan = plan_of()
    header = Header(notes=RunNotes.of("hut <i>", "Ada"), bench_json='{"name": "left table"}').stamped()
    writer = RecordingWriter.create(path, plan, header)
    for number in range(points):
        writer.write(sample_of(plan, number))
    writer.flush()
    return writer


def plain(html: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_it_shows_the_scan_under_way_and_then_that_there_is_none(data: Path) -> None:
    writer = growing(data / "night" / "3-hut.h5", 10)
    try:
        said = plain(body(data))
        assert "hut &lt;i&gt; 10 of 30 points" in said
        assert "Ada, bench left table" in said
    finally:
        writer.finish(Status.INTERRUPTED)
    said = plain(body(data))
    assert "No scan is under way." in said
    assert "10 of 30 points" in said  # on its card


def test_a_recording_that_is_just_begun_or_resumed_is_no_scan_under_way_before_it_can_be_read(data: Path) -> None:
    writer = growing(data / "whole.h5", 10)
    writer.finish(Status.INTERRUPTED)
    (data / "torn.h5").write_bytes((data / "whole.h5").read_bytes()[:3000])
    locks = [WriterLock(data / name) for name in ("whole.h5", "torn.h5")]
    try:
        said = plain(body(data))
    finally:
        for lock in locks:
            lock.release()
    assert "No scan is under way." in said
    assert "The latest of 2 runs" in said


def test_it_shows_how_far_the_series_is_and_why_a_scan_ended(data: Path) -> None:
    lock = WriterLock(data / "night" / NAME)  # as `nlos queue` holds it
    try:
        said = plain(body(data))
    finally:
        lock.release()
    assert "Series night 2 of 3 scans, until about" in said
    assert "2-cap alarm too &lt;b&gt;bright&lt;/b&gt;" in said
    assert "3-hut waiting" in said
    assert "not running now" in plain(body(data))
    Journal(data / "night").add("3-hut", DONE)
    assert "3 of 3 scans, over" in plain(body(data))


@pytest.mark.parametrize("what", [STORAGE, FAILED, INTERRUPTED])
def test_a_scan_that_the_series_resumes_is_not_over(data: Path, what: str) -> None:
    journal = Journal(data / "night")
    journal.add("3-hut", BEGUN)
    journal.add("3-hut", what, message="the disk is full")
    said = plain(body(data))
    assert "2 of 3 scans, not running now" in said
    assert f"3-hut {what} the disk is full" in said
    lock = WriterLock(data / "night" / NAME)
    try:  # and its hour is still to come
        ends = re.search(r"2 of 3 scans, until about (\w+ \d\d:\d\d)", plain(body(data)))
    finally:
        lock.release()
    assert ends is not None
    assert ends[1] in {shown_after(seconds) for seconds in (3540, 3600)}  # the minute may end meanwhile


def test_a_scan_that_an_alarm_ended_with_its_series_is_not_over(data: Path) -> None:
    """`on_alarm: stop`, the default: what is missing of it is taken when the series is resumed."""
    journal = Journal(data / "night")
    journal.add("3-hut", BEGUN)
    journal.add("3-hut", ALARM, message="too bright")
    assert "2 of 3 scans, not running now" in plain(body(data))


def test_the_series_that_is_going_is_shown_whatever_the_clock_says(data: Path) -> None:
    """It was set back meanwhile, or the disk's is another machine's."""
    (data / "older").mkdir()
    Journal(data / "older").add("1-cap", DONE)
    os.utime(data / "night" / NAME, (1, 1))
    assert "Series older" in plain(body(data))
    lock = WriterLock(data / "night" / NAME)
    try:
        assert "Series night" in plain(body(data))
    finally:
        lock.release()


def test_it_says_which_run_ended_the_series(data: Path) -> None:
    assert "1 of 3 scans, not running now: 2-cap alarm Scan" in plain(body(data))
    Journal(data / "night").add("3-hut", BEGUN)
    assert "not running now Scan" in plain(body(data))  # its program was killed


@pytest.mark.parametrize(
    ("bench", "ended"),
    [
        ({"simulation.faults": [{"name": "G1", "after_s": 0.1}]}, "failed: triggerscope: b"),
        ({"safety.trip_cps": 1e4, "safety.trip_ms": 1.0}, "stopped: shutter: closed by a trip: "),
    ],
)
def test_it_says_what_ended_the_last_scan(
    tmp_path: Path, bench: dict[str, Any], ended: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").mkdir()
    assert run(["scan", "five_by_five", "--bench", bench_file(tmp_path, bench), "-o", f"{tmp_path}/runs/run.h5"])
    said = plain(body(tmp_path / "runs"))
    assert f"No scan is under way. run.h5: {ended}" in said
    assert said.count(ended.split(": ", 1)[1]) == 2  # on its card, too
    capsys.readouterr()
    run(["runs", "--folder", f"{tmp_path}/runs"])
    assert ended.split(": ", 1)[1] in capsys.readouterr().out


@contextmanager
def served(folder: Path) -> Iterator[int]:
    door = socket.create_server(("127.0.0.1", 0))
    port = int(door.getsockname()[1])
    server = WebServer(door, StatusPage(folder, TOKEN, {f"127.0.0.1:{port}"}))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield port
    finally:
        server.stop()
        thread.join(10)
        assert not thread.is_alive()


def asked(port: int, method: str, path: str, host: str | None = None) -> tuple[int, str, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.request(method, path, headers={} if host is None else {"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), dict(answer.getheaders())
    finally:
        connection.close()


def test_who_has_the_address_may_look_and_nobody_may_do_anything(data: Path) -> None:
    with served(data) as port:
        status, html, headers = asked(port, "GET", f"/{TOKEN}/")
        assert status == 200
        assert "Series night" in html
        assert "<script" not in html
        assert "script-src" not in headers["Content-Security-Policy"]
        assert headers["Content-Security-Policy"].startswith("default-src 'none'")
        assert 'http-equiv="refresh"' in html
        still = asked(port, "GET", f"/{TOKEN}/?still=1")[1]  # for who reads it line by line, by keys or by ear
        assert "http-equiv" not in still
        assert ['class="big old"' in each for each in (html, still)] == [True, False]  # a page that holds still is old
        assert [('href="?still=1"' in each, 'href="?"' in each) for each in (html, still)] == [
            (True, False),
            (False, True),
        ]
        assert "<th scope=row>2-cap</th>" in html
        for other in ("/", f"/{TOKEN}", f"/{TOKEN[:-1]}/", f"//{TOKEN}/"):
            assert asked(port, "GET", other)[0] == 403
        assert asked(port, "GET", "/corridor-corridoR/")[0] == 403
        status, why, _ = asked(port, "GET", f"/{TOKEN}/", host="evil.example")
        assert status == 403
        assert "use the whole address" in json.loads(why)["message"]
        assert asked(port, "GET", f"/{TOKEN}/../etc")[0] == 404
        for method in ("POST", "PUT", "DELETE"):
            assert asked(port, method, f"/{TOKEN}/")[0] == 405
    assert json.loads((data / "night" / "plan.json").read_text())["3-hut"] == 3600.0


@pytest.mark.skipif(os.name == "nt", reason="no process is sent Ctrl-C there")
@pytest.mark.parametrize("ends", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_the_folder_under_the_address_it_says_until_it_is_told_to_end(
    data: Path, ends: signal.Signals
) -> None:
    command = [sys.executable, "-m", "nlos", "status", str(data), "--token", TOKEN]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as page:
        try:
            assert page.stdout is not None
            there = urlsplit(page.stdout.readline().strip())
            assert (there.hostname, there.path) == ("127.0.0.1", f"/{TOKEN}/")
            assert there.port is not None
            status, html, _ = asked(there.port, "GET", there.path)
            assert (status, "Series night" in html) == (200, True)
            assert asked(there.port, "GET", there.path, host=f"localhost:{there.port}")[0] == 200
            assert asked(there.port, "GET", there.path, host="evil.example")[0] == 403
            page.send_signal(ends)
            assert page.wait(240) == 128 + ends
        finally:
            page.kill()


def test_a_computer_is_called_in_capitals_and_by_its_ipv6_address_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "LAB-PC")  # which browsers send in small letters, others as is
    there = Request(f"/{TOKEN}/", {}, "")
    for host, named in (("127.0.0.1", "127.0.0.1"), ("::1", "[::1]"), ("[0:0::1]", "[::1]")):
        try:
            door, names = listening_at(host, 0)
        except UsageError:
            assert ":" in host, host
            pytest.skip("this computer has no IPv6")
        with door:
            port = door.getsockname()[1]
            assert names[0] == f"{named}:{port}"
            for name in (names[0], f"lab-pc:{port}", f"LAB-PC:{port}"):
                assert admitted(replace(there, host=name), TOKEN.encode(), names) == ""
            with pytest.raises(Refused):
                admitted(replace(there, host=f"other:{port}"), TOKEN.encode(), names)
            with socket.create_connection((host.strip("[]"), port), timeout=60):
                pass


def test_a_page_is_reached_by_the_number_of_its_name_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser also makes a number of one that is written in short, as 10.1 is."""
    monkeypatch.setattr("nlos.cli.status.listening_address", lambda host: {"lab-pc": "::1"}[host])
    try:
        door, names = listening_at("lab-pc", 0)
    except UsageError:
        pytest.skip("this computer has no IPv6")
    with door:
        port = door.getsockname()[1]
    assert names[:2] == [f"lab-pc:{port}", f"[::1]:{port}"]


@pytest.mark.parametrize("host", ["[", "[]", "[127.0.0.1]", "ä" * 64, "0.0.0.0", "::", ""])
def test_what_is_no_address_is_none_of_all_that_this_computer_has(host: str) -> None:
    with pytest.raises(UsageError, match="--host"):
        listening_at(host, 0)


@pytest.mark.parametrize(
    "token", ["fifteen-letters", "x" * 101, "a-word/with-strokes", "ä" * 20, "two words in one word"]
)
def test_a_token_that_no_address_holds_is_refused(
    data: Path, token: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(WebServer, "run", lambda server: None)
    assert run(["status", str(data), "--token", token]) == 2
    assert "16 to 100 of a-z" in capsys.readouterr().err
    assert run(["status", str(data / "gone")]) == 2


def test_a_folder_that_is_gone_is_not_called_a_folder_without_scans(data: Path) -> None:
    gone = data.rename(data.with_name("elsewhere")).with_name("data")
    said = plain(body(gone))
    assert "cannot be read (No such file or directory). Whether a scan is under way is not known here." in said
    assert "No scan is under way" not in said


def test_a_page_that_could_never_be_made_is_not_served(
    data: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service of a user without a home folder: whoever asked was hung up on."""
    monkeypatch.setattr(WebServer, "run", lambda server: None)
    monkeypatch.delenv("NLOS_STATE")
    monkeypatch.setenv("HOME", "")
    assert run(["status", str(data)]) == 2
    assert "no home folder" in capsys.readouterr().err

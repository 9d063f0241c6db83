"""The live page, read-only and sealed; scans that end when they are good enough."""

import http.client
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from nlos.acquisition.recording.recording import Recording

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 8}
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""


@pytest.fixture
def page(nlos: Nlos, tmp_path: Path) -> Iterator[str]:
    """The address of the page of a finished scan."""
    (tmp_path / "scan.yaml").write_text(SCAN)
    assert nlos("scan", "scan.yaml", "-o", "run.h5").returncode == 0
    viewer = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", "run.h5"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    )
    assert viewer.stdout is not None
    url = viewer.stdout.readline().strip()
    deadline_s = time.monotonic() + 60
    while not ask(url, "state").get("over"):
        assert time.monotonic() < deadline_s
        time.sleep(0.1)
    yield url
    viewer.send_signal(signal.SIGINT)
    assert viewer.wait(20) == 0


def get(url: str, path: str, method: str = "GET", host: str | None = None) -> tuple[int, bytes, dict[str, str]]:
    there = urlsplit(url)
    connection = http.client.HTTPConnection("127.0.0.1", there.port or 0, timeout=30)
    connection.request(method, path, headers={"Host": host or there.netloc})
    answer = connection.getresponse()
    return answer.status, answer.read(), {key.lower(): value for key, value in answer.getheaders()}


def ask(url: str, what: str) -> dict[str, object]:
    status, body, _ = get(url, urlsplit(url).path + what)
    assert status == 200, body
    found = json.loads(body)
    assert isinstance(found, dict)
    return found


def test_the_page_is_read_only_and_sealed(page: str) -> None:
    own = urlsplit(page).path
    state = ask(page, "state")
    assert (state["samples"], state["planned"], state["skipped"]) == (256, 256, 0)
    picture = ask(page, "picture")
    assert (picture["samples"], len(picture["albedo"]), len(picture["confidence"])) == (256, 16, 16)  # type: ignore[arg-type]
    assert ask(page, "picture?samples=64")["samples"] == 64
    assert len(ask(page, "histogram?row=3&col=15")["counts"]) == 512  # type: ignore[arg-type]
    for path in ("histogram?row=99&col=0", "histogram?row=-1&col=x", "histogram"):
        assert get(page, own + path)[0] == 404
    status, body, headers = get(page, own)
    assert status == 200
    assert b"NONCE" not in body
    assert "default-src 'none'" in headers["content-security-policy"]
    for path in ("/", "/state", "/wrong/state", own[:-1], own[:-2] + "/state", "/%ff%fe/state", f"{own[1:]}"):
        assert get(page, path)[0] in (400, 403), path
    assert get(page, own + "state", host="evil.example")[0] == 403
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD"):
        assert get(page, own + "state", method)[0] == 405


def test_a_scan_ends_when_its_picture_is_good_enough_and_says_so(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(SCAN)
    assert nlos("scan", "scan.yaml", "--until", "soon").returncode == 2
    answers = [nlos("scan", "scan.yaml", "-o", name, "--until", "stable:0.5", "--json") for name in ("a.h5", "b.h5")]
    taken = [json.loads(done.stdout)["points"] for done in answers if done.returncode == 0]
    assert len(taken) == 2
    assert taken[0] == taken[1] < 256
    with Recording.open(tmp_path / "a.h5") as recording:
        said = [event.text for event in recording.events() if event.kind == "until"]
    assert "is good enough: change" in said[-1]
    assert nlos("scan", "scan.yaml", "-o", "a.h5", "--resume").returncode == 0
    with Recording.open(tmp_path / "a.h5") as recording:
        assert len(recording) == 256

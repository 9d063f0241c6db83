"""Recordings whose names are no Unicode, or mean something in an address, are reconstructed, shown and linked to."""

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from nlos.acquisition.recording.layout import event_row
from nlos.acquisition.recording.recording import Recording
from nlos.cli.archive_page import page
from nlos.recon.results import read_reconstruction

NAME = os.fsdecode(b"caf\xe9")
TOLD = "caf\\xe9.h5"


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
def test_a_recording_in_latin_1_has_a_picture_a_report_and_a_copy(
    small: Path, nlos: Callable[..., Any], tmp_path: Path
) -> None:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    shutil.copyfile(tmp_path / "run.h5", tmp_path / f"{NAME}.h5")
    assert nlos("reconstruct", f"{NAME}.h5", "--method", "lct", "-o", "out", "--html", "--no-volume").returncode == 0
    assert read_reconstruction(tmp_path / "out" / "reconstruction.h5").scan == TOLD
    assert nlos("report", f"{NAME}.h5", "--methods", "lct", "-o", "r.html").returncode == 0
    assert f"<h1>{TOLD}</h1>" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert nlos("replay", f"{NAME}.h5", "--speed", "max", "-o", f"{NAME}2.h5").returncode == 0
    with Recording.open(tmp_path / f"{NAME}2.h5") as copy:
        assert any(TOLD in event.text for event in copy.events())


def test_an_event_about_such_a_file_is_written() -> None:
    assert event_row("constants", f"from {NAME}.h5")["text"][0] == b"from caf\\udce9.h5"


def test_an_archives_page_leads_to_its_pictures_whatever_they_are_called() -> None:
    names = [NAME, "a#b?c%41", "<i>\u202e"]
    rows = [
        {"file": f"{name}.h5", "folder": name, "outcome": "partial", "reason": "", "seconds": 1.0, "method": "lct"}
        for name in names
    ]
    html = page(rows)
    assert html.encode()  # what no file can hold is not in it
    assert "<i>" not in html
    assert "\u202e" not in html
    links = [each.partition('"')[0] for each in html.split('src="')[1:]]
    found = [unquote(link, errors="surrogateescape").partition("/")[0] for link in links]
    assert found == [name for name in names for _ in range(2)]

"""Recordings whose names are no Unicode, or mean something in an address, are reconstructed, shown and linked to."""

import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import pytest

from nlos.acquisition.recording.layout import event_row
from nlos.acquisition.recording.recording import Recording, Status
from nlos.cli.archive_page import page
from nlos.cli.benches import load_bench
from nlos.configs.load import find
from nlos.doctor.page import write_page as write_examination
from nlos.recon.methods import in_words, parse_settings
from nlos.recon.results import read_reconstruction
from nlos.runs.index import RunsIndex
from nlos.runs.page import write_page
from nlos.status_page import body
from tests.command import nlos
from tests.nlos.test_status_page import growing

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


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
def test_the_page_of_runs_leads_to_every_recording_and_its_picture(tmp_path: Path) -> None:
    """One of them cut short: why is told by its name. Below a folder whose name is no Unicode either."""
    folder = tmp_path / NAME
    folder.mkdir()
    for name in (NAME, "a#b?c%41", "d\\udce9"):
        growing(folder / f"{name}.h5", 30).finish(Status.COMPLETE)
        (folder / name).mkdir()
        (folder / name / "albedo.png").write_bytes(b"a picture of one")
    (folder / f"{NAME}-torn.h5").write_bytes((folder / f"{NAME}.h5").read_bytes()[:5000])
    with RunsIndex(folder, tmp_path / "index.sqlite") as index:
        index.update()
        write_page(tmp_path / "runs.html", folder, index.search(), "")
    html = (tmp_path / "runs.html").read_text(encoding="utf-8")
    assert f"/{NAME}-torn.h5: not a readable recording".replace("\udce9", "\\xe9") in html
    links = {os.fsdecode(unquote_to_bytes(each.partition('"')[0])) for each in html.split('href="')[1:]}
    assert links == {str(path.relative_to(tmp_path)) for path in folder.glob("*.h5")}
    assert html.count('class="picture"') == 3
    assert body(folder).encode()


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
def test_a_scan_under_way_is_told_in_the_corridor_whatever_it_is_called(tmp_path: Path) -> None:
    writer = growing(tmp_path / f"{NAME}.h5", 10)
    try:
        assert "10 of 30 points since" in body(tmp_path)
    finally:
        writer.finish(Status.INTERRUPTED)


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
def test_an_examinations_page_names_its_bench_file_whatever_that_is_called(tmp_path: Path) -> None:
    shutil.copyfile(find("bench", "simulated"), tmp_path / f"{NAME}.yaml")
    write_examination(tmp_path / "day.html", load_bench(str(tmp_path / f"{NAME}.yaml")), [], {}, False)
    assert f"{tmp_path}/caf\\xe9.yaml" in (tmp_path / "day.html").read_text(encoding="utf-8")


def test_weights_in_such_a_file_make_pictures() -> None:
    """They were a bug of ours."""
    chosen = parse_settings("nano", {"weights": "m\udcff.safetensors"})
    assert json.loads(in_words(chosen))["weights"] == "m\udcff.safetensors"


def test_a_word_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """A terminal of another encoding than the program's: an umlaut in the C locale, say."""
    done = nlos(tmp_path, "runs", "--folder", ".", NAME)
    assert done.returncode == 2
    assert done.stderr == f"nlos: {NAME!r}: is not UTF-8 text; set the terminal's encoding to UTF-8\n"

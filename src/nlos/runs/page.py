"""Runs as a page with thumbnails, one HTML file that loads nothing: each picture, or the rates, on a card."""

import base64
import os
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nlos.cli.escaped import escaped
from nlos.runs.grey_png import grey_png
from nlos.runs.index import Run
from nlos.whole_file import whole_file

_LARGEST_PICTURE = 200_000
"""Bytes of a picture that is taken as it is; a larger one is too much for a card."""


def write_page(target: Path, folder: Path, runs: Sequence[Run], words: str, *, new: bool = False) -> None:
    """Raises `OSError` where it cannot be written; then an older page is as it was. A `new` one: as `whole_file`."""
    with whole_file(target, new=new) as partial:
        partial.write_text(page(folder, runs, words, target.absolute().parent), encoding="utf-8")


def page(folder: Path, runs: Sequence[Run], words: str, from_folder: Path | None = None) -> str:
    """The page; with `from_folder`, names lead from there to the recordings."""
    style = (files("nlos.runs") / "page.css").read_text(encoding="utf-8")
    title = f"{len(runs)} runs in {folder.resolve().name}" + (f": {words}" if words else "")
    cards = "".join(card(folder, run, from_folder) for run in runs)
    return escaped(
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width, initial-scale=1"><title>{escape(title)}</title><style>{style}</style></head>'
        f"<body><h1>{escape(title)}</h1><main>{cards}</main></body></html>"
    )


def card(folder: Path, run: Run, from_folder: Path | None = None) -> str:
    """One run: its picture, what was said and measured. With `from_folder` its name leads to the recording."""
    said = run.summary
    name = escape(Path(run.path).name)
    if from_folder is not None:
        shown = Path(os.path.relpath(run.file(folder.resolve()), from_folder))
        name = f'<a href="{quote(os.fsencode(shown.as_posix()))}">{name}</a>'
    tags = "".join(f"<li>{escape(tag)}</li>" for tag in said.get("tags", []))
    return (
        f'<article class="{escape(run.status.replace(" ", "-"))}">{_picture(folder, run)}<div>'
        f"<h2>{escape(str(said.get('sample', ''))) or name}</h2>"
        f'<p class="when">{escape(run.started)} <strong>{escape(run.status)}</strong></p>'
        f"<p>{_measured(said)}</p>"
        + (f"<p>{escape(said['operator'])}</p>" if said.get("operator") else "")
        + (f'<p class="note">{escape(said["note"])}</p>' if said.get("note") else "")
        + (f'<p class="note">{escape(said["trouble"])}</p>' if said.get("trouble") else "")
        + (f"<ul>{tags}</ul>" if tags else "")
        + f'<p class="file">{name}</p></div></article>'
    )


def _measured(said: dict[str, Any]) -> str:
    if "points" not in said:
        return ""
    width_m, height_m = said["wall"]
    return (
        f"{said['points']:,} of {said['planned']:,} points, {said['photons']:,} photons, {width_m:g} × {height_m:g} m, "
        f"{escape(said['bench'])}"
    )


def _picture(folder: Path, run: Run) -> str:
    """The reconstruction beside the recording, else the rates over the wall."""
    picture = run.file(folder).with_suffix("") / "albedo.png"
    try:
        if picture.is_file() and picture.stat().st_size <= _LARGEST_PICTURE:
            return _image(picture.read_bytes(), f"reconstruction of {run.path}")
    except OSError:
        pass
    thumbnail = run.summary.get("thumbnail")
    if not thumbnail:
        return '<div class="none">no picture</div>'
    grey = base64.b64decode(thumbnail["grey"])
    return _image(
        grey_png(grey, thumbnail["rows"], thumbnail["cols"]), f"count rate over the wall of {run.path}", "rates"
    )


def _image(png: bytes, what: str, kind: str = "picture") -> str:
    return f'<img class="{kind}" alt="{escape(what)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'

"""What the screen in the corridor shows of a data folder: the scan under way, the series, and the latest runs.

Read-only and without a script: the browser asks again by itself, unless it is told to hold still for who reads it line
by line, by keys or by ear. Made from files alone, by a process of its own, so
that nothing a visitor does reaches the laser, the mirrors or a recording.
"""

import os
import threading
import time
from collections.abc import Sequence
from datetime import datetime
from html import escape
from importlib.resources import files
from pathlib import Path

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.cli.escaped import escaped
from nlos.live.admission import admitted, page_answer
from nlos.live.web import Answer, Refused, Request
from nlos.runs.index import Run, RunsIndex
from nlos.runs.page import card
from nlos.series.journal import BEGUN, DONE, NO_PICTURE, PICTURE, Journal, planned
from nlos.series.journal import NAME as JOURNAL
from nlos.time_of_day import shown_after

AGAIN_S = 5
"""How often the browser asks; the folder is looked at no more often than that."""
OLD_S = 20
"""A page that is still shown so long after it came says so: by its style, for it has no script, and a browser that
waits for an answer leaves what it has where it is."""
LATEST = 12
_OLD = "No answer: what is below is old. It is of the time beside the name of the folder."
_HEAD = "<tr><th scope=col>Scan</th><th scope=col>Outcome</th><th scope=col>Why</th></tr>"


class StatusPage:
    """Answers whoever names one of `hosts` and begins the path with `token`."""

    def __init__(self, folder: Path, token: str, hosts: set[str]) -> None:
        self._folder, self._token, self._hosts = folder, token.encode(), hosts
        self._style = (files("nlos.runs") / "page.css").read_text(encoding="utf-8")
        self._lock, self._body, self._made_s = threading.Lock(), "", -float("inf")

    def __call__(self, request: Request) -> Answer:
        """Raises `Refused`."""
        if admitted(request, self._token, self._hosts):
            raise Refused(404)
        still = "still" in request.query
        again = "" if still else f'<meta http-equiv="refresh" content="{AGAIN_S}">'
        old = "" if still else f'<p class="big old">{_OLD}</p>'
        other = f'<a href="?">Ask again every {AGAIN_S} s</a>' if still else '<a href="?still=1">Hold still</a>'
        return page_answer(
            '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
            f'content="width=device-width, initial-scale=1">{again}'
            f'<title>nlos status</title><style nonce="NONCE">{self._style}</style></head><body>{old}{self._current()}'
            f"<footer>{other}</footer></body></html>",
            scripts=False,
        )

    def _current(self) -> str:
        """The page's body; visitors at the same time get the same one."""
        with self._lock:
            if time.monotonic() - self._made_s >= AGAIN_S:
                self._body, self._made_s = body(self._folder), time.monotonic()
            return self._body


def body(folder: Path) -> str:
    """What is known of the folder now."""
    try:
        os.scandir(folder).close()
    except OSError as error:  # a disk that was pulled out holds no runs either, but that is not what it means
        gone = f"{folder}: cannot be read ({error.strerror}). Whether a scan is under way is not known here."
        return escaped(f'<h1>{escape(folder.name)}</h1><p class="big">{escape(gone)}</p>')
    try:
        with RunsIndex(folder) as index:
            if index.not_kept is not None:  # it would read every recording for every look at the page
                raise index.not_kept
            index.update()
            latest, every = index.search(limit=LATEST), index.count()
    except StorageError as error:
        return escaped(f"<h1>{escape(folder.name)}</h1><p>{escape(str(error))}</p>")
    now = f"{datetime.now():%Y-%m-%d %H:%M:%S}"
    growing = [run for run in latest if run.status == "running" and is_locked(run.file(folder))]
    cards = "".join(card(folder, run) for run in latest)
    return escaped(
        f'<h1>{escape(folder.resolve().name)} <span class="when">{now}</span></h1>{_under_way(growing, latest)}'
        f"{_series(folder)}<section><h2>The latest of {every} runs</h2><main>{cards}</main></section>"
    )


def _under_way(growing: Sequence[Run], latest: Sequence[Run]) -> str:
    """The scans that are, else what ended the last one, where that was no person and not its last point."""
    if not growing:
        last = next(iter(latest), None)
        why = "" if last is None else last.summary.get("trouble", "")
        ended = f"<p>{escape(Path(last.path).name)}: {escape(last.status)}: {escape(why)}</p>" if last and why else ""
        return f'<section><p class="big">No scan is under way.</p>{ended}</section>'
    return "".join(
        f'<section><p class="big">{escape(str(run.summary.get("sample") or Path(run.path).stem))}</p>'
        f'<progress aria-label="points" max="{run.summary["planned"]}" value="{run.summary["points"]}"></progress>'
        f"<p>{run.summary['points']:,} of {run.summary['planned']:,} points since {escape(run.started)}; "
        f"{escape(str(run.summary.get('operator') or 'nobody named'))}, bench {escape(run.summary['bench'])}</p>"
        "</section>"
        for run in growing
    )


def _series(folder: Path) -> str:
    """The series below the folder that is going, else the one whose journal changed last."""
    try:
        journals = sorted(folder.glob(f"**/{JOURNAL}"), key=lambda path: (is_locked(path), path.stat().st_mtime))
    except OSError:
        return ""
    if not journals:
        return ""
    here = journals[-1].parent
    journal, expected_s = Journal(here), planned(here)
    outcome = {name: journal.outcome(name) for name in expected_s}
    going = is_locked(here / JOURNAL)
    over = [name for name in outcome if journal.is_over(name, going)]
    left_s = sum(seconds for name, seconds in expected_s.items() if name not in over)
    ends = f"until about {shown_after(left_s)}" if going else f"not running now{_ended_by(journal)}"
    if len(over) == len(outcome):
        ends = "over"
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}</th><td>{escape('under way' if going and what == 'cut off' else what)}</td>"
        f"<td>{escape(_why(journal, name))}</td></tr>"
        for name, what in outcome.items()
    )
    return (
        f'<section><h2>Series {escape(here.name)}</h2><p class="big">{len(over)} of {len(outcome)} scans, {ends}</p>'
        f'<progress aria-label="scans" max="{max(len(outcome), 1)}" value="{len(over)}"></progress>'
        f"<table>{_HEAD}{rows}</table></section>"
    )


def _ended_by(journal: Journal) -> str:
    """The run that ended the series, unless all went well as far as it came."""
    ends = [line for line in journal.lines if line.what not in (PICTURE, NO_PICTURE)][-1:]
    return "".join(f": {escape(line.run)} {line.what}" for line in ends if line.what not in (BEGUN, DONE))


def _why(journal: Journal, name: str) -> str:
    last = journal.last(name)
    return "" if last is None or last.what == "done" else last.message

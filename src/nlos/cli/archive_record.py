"""archive.json and index.html of an archive: what became of every file, kept from one call to the next.

`archive.json` is a list of rows: `file`, `outcome` (done, failed, unfinished), `reason`, `code` (the exit code of that
file alone), `seconds`, `worker` (HOST:PID), `folder`, `method`, `settings`.
"""

import json
import time
from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from nlos.cli.terminal import terminal
from nlos.recon.results import NAMES

if TYPE_CHECKING:
    from nlos.cli.archive_task import Outcome, Task

Row = dict[str, Any]
RECORD, PAGE = "archive.json", "index.html"
EVERY_S = 1.0
"""archive.json is written so often while files are done, and at the end whatever ends it."""
STYLE = (
    "body{font:15px system-ui;margin:2em;background:#111;color:#ddd}main{display:flex;flex-wrap:wrap;gap:1em}"
    "figure{margin:0;width:220px}img{width:100%;background:#000}a{color:inherit}td{padding:.2em 1em .2em 0;"
    "vertical-align:top}small{color:#999}"
)


class ArchiveRecord:
    """The record of one archive's folder. As a context it is written down on every way out."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / RECORD
        self._rows: dict[str, Row] = {row["file"]: row for row in _read(self.path)}
        self._written_s = 0.0

    def has(self, task: "Task", overwrite: bool, skip_existing: bool) -> bool:
        """Whether the task's results are there and may stay. Raises `FileExistsError` where they may neither stay nor
        be replaced; half a result, of an attempt that was killed, is replaced with `skip_existing`."""
        there = [name for name in NAMES if (task.results.path / name).exists()]
        if not there or overwrite:
            return False
        if not skip_existing:
            raise FileExistsError(
                f"{task.results.path / there[0]}: exists. Choose another folder with -o, or use --skip-existing or "
                "--overwrite."
            )
        row = self._rows.get(task.file)
        if row is None and len(there) == len(NAMES):
            self._rows[task.file] = _row(task, "done", "was there already", 0, None, "")
            return True
        if row is not None and row["outcome"] == "done" and len(there) == len(NAMES):
            if (row["method"], row["settings"]) != (task.recipe.method, _plain(task.recipe.settings)):
                raise FileExistsError(
                    f"{task.results.path}: holds a result of {row['method']} by other settings. Choose another "
                    "folder with -o, or use --overwrite."
                )
            return True
        return False

    def add(self, task: "Task", outcome: "Outcome") -> None:
        """One more file has an outcome."""
        self._rows[task.file] = _row(
            task, outcome.outcome, outcome.reason, outcome.code, outcome.seconds, outcome.worker
        )
        if time.monotonic() - self._written_s > EVERY_S:
            self.write()

    def rows_of(self, files: Iterable[str]) -> list[Row]:
        """The rows of these files."""
        return [self._rows[file] for file in files if file in self._rows]

    def write(self) -> None:
        """Replaces archive.json at once: a reader meets the old one or the new one."""
        _replace(self.path, json.dumps([self._rows[file] for file in sorted(self._rows)], indent=1) + "\n")
        self._written_s = time.monotonic()

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.write()
        _replace(self.folder / PAGE, page([self._rows[file] for file in sorted(self._rows)], self.folder))


def page(rows: list[Row], folder: Path) -> str:
    """The gallery: every picture, smallest text that says which, and why the others are missing."""
    done = [row for row in rows if row["outcome"] == "done"]
    failed = [row for row in rows if row["outcome"] != "done"]
    figures = "".join(_figure(row, folder) for row in done)
    reasons = "".join(f"<tr><td>{escape(row['file'])}<td>{escape(row['reason'])}" for row in failed)
    table = f"<h2>Without a result</h2><table>{reasons}</table>" if failed else ""
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{len(done)} reconstructions</title>'
        f"<style>{STYLE}</style><h1>{len(done)} of {len(rows)} files</h1>{table}<main>{figures}</main></html>\n"
    )


def _figure(row: Row, folder: Path) -> str:
    place = Path(row["folder"])
    where = place.relative_to(folder).as_posix() if place.is_relative_to(folder) else place.as_posix()
    took = "" if row["seconds"] is None else f", {row['seconds']:.1f} s"
    return (
        f'<figure><a href="{escape(where)}/"><img loading="lazy" src="{escape(where)}/albedo.png" alt="front view">'
        f'<img loading="lazy" src="{escape(where)}/depth.png" alt="depth"></a>'
        f"<figcaption>{escape(row['file'])}<br><small>{escape(row['method'])}{took}</small></figcaption></figure>"
    )


def _row(task: "Task", outcome: str, reason: str, code: int, seconds: float | None, worker: str) -> Row:
    return {
        "file": task.file, "outcome": outcome, "reason": reason, "code": code, "seconds": seconds, "worker": worker,
        "folder": str(task.results.path), "method": task.recipe.method, "settings": _plain(task.recipe.settings),
    }  # fmt: skip


def _plain(settings: Mapping[str, object]) -> Any:
    return json.loads(json.dumps(settings, default=str))


def _read(path: Path) -> list[Row]:
    """The rows of an earlier call; none where there is no such file, or nothing that makes sense."""
    try:
        held = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        terminal.log(f"{path}: not readable ({error}); it is written from scratch")
        return []
    if not isinstance(held, list):
        return []
    needed = {"file", "outcome", "reason", "seconds", "folder", "method", "settings"}
    return [row for row in held if isinstance(row, dict) and needed <= row.keys()]


def _replace(path: Path, text: str) -> None:
    fresh = path.with_name(f".{path.name}.new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)

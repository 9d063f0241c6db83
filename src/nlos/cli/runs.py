"""`nlos runs`: finds scans again, by sample, operator, note, tag, day, or anything else that is known of them."""

import textwrap
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.columns import columns_shown, one_line, padded, width_shown
from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import check_folder, check_place, page_target
from nlos.cli.terminal import terminal
from nlos.runs.index import SORTS, Run, RunsIndex

_LONGEST = 40
_HEADS = ("started", "status", "points", "sample", "operator", "tags", "path", "note")


def runs(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WORDS]", help="All must fit: hat, sample:hat, tag:night, since:2026-03, until:2026-04-02"
        ),
    ] = None,
    folder: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Default: the data folder of defaults.yaml, or this folder.")
    ] = None,
    sort: Annotated[str, typer.Option(metavar="FIELD", help="started, sample, operator, photons, ...")] = "started",
    ascending: Annotated[bool, typer.Option("--ascending", help="The smallest or oldest first.")] = False,
    limit: Annotated[int, typer.Option(min=1, help="At most this many.")] = 50,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Read every file again.")] = False,
    page: Annotated[
        Path | None, typer.Option(metavar="F.html", help="Write them as a page with thumbnails as well.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing page.")] = False,
) -> None:
    """Lists recordings below a folder, the latest first. The index is made from the files and brought up to date
    first; deleting it loses nothing."""
    where = folder or _data_folder() or Path()
    check_folder(where)
    if sort not in SORTS:
        raise UsageError(f"--sort {sort}: choose one of {', '.join(SORTS)}")
    if page is not None:
        check_place(page_target(page), overwrite, "--page")
    with RunsIndex(where) as index:
        changes = index.update(afresh=rebuild)
        found, every = index.search(words or [], sort, not ascending, limit), index.count()
    if index.not_kept is not None:
        terminal.log(f"warning: {index.not_kept} Until then each search reads every recording again.")
    if changes.unreadable:
        terminal.log(f"warning: {changes.unreadable} recordings cannot be read: `nlos runs status:unreadable`")
    _show(found)
    terminal.result(f"{len(found)} of {every} runs in {where}", total=every, folder=str(where))
    terminal.document["runs"] = [
        {"path": run.path, "started": run.started, **{k: v for k, v in run.summary.items() if k != "thumbnail"}}
        for run in found
    ]
    if page is not None:
        from nlos.runs.page import write_page

        page.absolute().parent.mkdir(exist_ok=True)
        write_page(page, where, found, " ".join(words or []), new=not overwrite)
        terminal.result(str(page), page=str(page))


def _data_folder() -> Path | None:
    from nlos.run_defaults import data_folder  # reads YAML, which takes longer than a search

    return data_folder()


def _show(found: "list[Run]") -> None:
    """One line each, in columns."""
    lines: list[tuple[str, ...]] = [_HEADS]
    for run in found:
        said = run.summary
        points = f"{said['points']}/{said['planned']}" if "points" in said else ""
        lines.append((run.started, run.status, points, str(said.get("sample", "")), str(said.get("operator", "")),
                      ",".join(said.get("tags", [])), run.path,
                      str(said.get("note") or said.get("trouble", ""))))  # fmt: skip
    if len(lines) == 1:
        return
    lines = [
        tuple(one_line(cell if _HEADS[column] == "path" else _cut(cell)) for column, cell in enumerate(line))
        for line in lines
    ]
    widths = [max(width_shown(line[column]) for line in lines) for column in range(len(lines[0]))]
    columns = columns_shown()
    if columns is not None and sum(widths) + 2 * sum(width > 0 for width in widths) - 2 > columns:
        _show_narrow(lines[1:], columns)
        return
    for line in lines:
        cells = [padded(cell, width) for cell, width in zip(line, widths, strict=True)]
        terminal.result("  ".join(cells).rstrip())


def _show_narrow(lines: list[tuple[str, ...]], columns: int) -> None:
    """Where a line is too short for all of it: when, how and how much, what was said by name, and the whole path."""
    for line in lines:
        terminal.result("  ".join(filter(None, line[:3])))
        said = ", ".join(f"{head} {cell}" for head, cell in zip(_HEADS[3:], line[3:], strict=True)
                         if cell and head != "path")  # fmt: skip
        for part in textwrap.wrap(said, max(columns - 4, 20)):
            terminal.result(f"    {part}")
        terminal.result(f"    {line[_HEADS.index('path')]}")


def _cut(text: str) -> str:
    one = " ".join(text.split())
    return one if len(one) <= _LONGEST else f"{one[: _LONGEST - 1]}…"

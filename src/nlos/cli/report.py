"""`nlos report`: one self-contained HTML file about a recording, to mail to a colleague."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.terminal import terminal


def report(
    run: Annotated[Path, typer.Argument(metavar="RUN")],
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="F.html")] = None,
    methods: Annotated[str, typer.Option(help="Method names, separated by commas; see `nlos methods`.")] = "lct",
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """What was scanned, with what, how well it calibrates, pictures by every method asked for, and the event log."""
    from nlos.report.page import write_report

    target = output or run.with_suffix(".html")
    if target.exists() and not overwrite:
        raise FileExistsError(f"{target}: exists. Choose another name with -o, or say --overwrite.")
    words = [word.strip() for word in methods.split(",") if word.strip()]
    write_report(run, target, words)
    terminal.result(f"{target}: {target.stat().st_size / 1e6:.1f} MB, self-contained", report=str(target))

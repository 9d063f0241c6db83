"""`nlos report`: one self-contained HTML file about one recording or several, to mail to a colleague."""

from os.path import realpath
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import check_place, page_target, refuse_folder, refuse_own_input
from nlos.cli.terminal import terminal
from nlos.live.process import methods_for
from nlos.report.page import write_report


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings; several are set side by side.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="F.html")] = None,
    methods: Annotated[
        str | None,
        typer.Option(help="Method names, separated by commas, the best first; nano,lct where torch is."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """The best picture, how good it is, 3D, other methods, calibration, rates, and then tables and the event log."""
    for run in runs:
        refuse_folder(run)
    target = runs[0].with_suffix(".html") if output is None else page_target(output)
    refuse_own_input(target, runs, "a recording that is reported on")
    check_place(target, overwrite)
    if len({realpath(run) for run in runs}) < len(runs):
        raise UsageError("the same RUN is named twice")
    words = methods_for(None)[::-1] if methods is None else [word.strip() for word in methods.split(",")]
    if not all(words) or len(set(words)) < len(words):
        raise UsageError(f"--methods {methods}: different method names, separated by commas")
    target.absolute().parent.mkdir(exist_ok=True)
    write_report(runs, target, words, new=not overwrite)
    terminal.result(f"{target}: {target.stat().st_size / 1e6:.1f} MB, self-contained", report=str(target))

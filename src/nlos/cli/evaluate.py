"""`nlos evaluate`: methods on scenes with ground truth."""

import os
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.exit_codes import Stopped, exit_code
from nlos.cli.file_words import Response
from nlos.cli.method_settings import parse_settings
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal
from nlos.recon import evaluate as evaluation
from nlos.recon.device import check_device
from nlos.recon.methods import usable
from nlos.response import response_wanted, with_response
from nlos.writable import check_writable

MOST_NAMED = 3


def evaluate(
    data: Annotated[list[Path], typer.Option("--data", metavar="PATH", help="Scene files or folders of them.")],
    more: Annotated[list[Path] | None, typer.Argument(metavar="[PATH]...", help="More scene files or folders.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR")] = Path("out"),
    methods: Annotated[
        str | None,
        typer.Option(help="Names, files of methods, NAME=FILE for those or for weights; between commas. Default: all."),
    ] = None,
    conditions: Annotated[str | None, typer.Option(help="Dataset names, optionally ~300ps, @RxC or @blue:N.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    fixed: Annotated[
        bool, typer.Option("--fixed", help="Run each method at its defaults instead of its best snr.")
    ] = False,
    response: Response = "auto",
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Every method on every scene under every condition: a table, and a gallery."""
    from nlos.recon.evaluation_report import NAMES, write_evaluation

    scenes = [*data, *(more or [])]
    for path in scenes:
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file or folder")
    check_writable(output)
    for name in NAMES:
        if os.path.lexists(output / name) and not overwrite:
            raise FileExistsError(f"{output / name}: exists. Choose another folder with -o, or use --overwrite.")
    check_device(device)
    wanted = response_wanted(response)
    chosen = methods.split(",") if methods else usable()
    with Progress(1, what="evaluate", unit="pictures") as progress:

        def step(done: int, total: int, at: str) -> None:
            progress.going_to(total)
            progress.step()
            progress.at(at)

        done = evaluation.evaluate(
            scenes,
            chosen,
            conditions.split(",") if conditions else evaluation.CONDITIONS,
            settings=parse_settings(settings or []),
            fixed=fixed,
            device=device,
            response=lambda transient: with_response(transient, wanted),
            say=terminal.log,
            step=step,
        )
    paths = write_evaluation(output, done, overwrite)
    terminal.document["results"] = evaluation.as_json(done.rows)
    terminal.document["without"] = [
        {"scene": each.scene, "method": each.method, "condition": each.condition, "reason": each.why}
        for each in done.without
    ]
    terminal.result("\n".join(str(path) for path in paths), files=[str(path) for path in paths])
    if done.without:
        raise Stopped(
            max(exit_code(each.error) for each in done.without),
            f"{output}: {len(done.without)} of {len(done.without) + len(done.rows)} results are missing: "
            f"{'; '.join(map(str, done.without[:MOST_NAMED]))}{'; ...' if len(done.without) > MOST_NAMED else ''}",
        )

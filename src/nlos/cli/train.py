"""`nlos train CONFIG`: train a learned method, alone or as one of several processes under torchrun."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.terminal import terminal


def train(
    config: Annotated[str, typer.Argument(metavar="CONFIG", help="A YAML file, or the name of one in configs/train.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Folder of the run. Default: runs/train/NAME.")
    ] = None,
    max_minutes: Annotated[
        float | None, typer.Option(help="Stop after this many minutes; the same command resumes.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Start over instead of resuming.")] = False,
) -> None:
    """Train a learned method; an interrupted run goes on from its last checkpoint."""
    from nlos.configs.load import load
    from nlos.recon.training import train as training
    from nlos.recon.training.run_folder import LOG, STATE, WEIGHTS
    from nlos.recon.training.train_settings import TrainSettings

    loaded = load("train", config, TrainSettings)
    settings = loaded.settings
    folder = output or Path("runs/train") / loaded.path.stem
    if max_minutes is not None:
        settings = settings.model_copy(update={"max_minutes": max_minutes})
    if overwrite:
        for name in (STATE, WEIGHTS, LOG):
            (folder / name).unlink(missing_ok=True)
    summary = training.train(settings, folder, terminal.log)
    figures = ", ".join(f"{name} {value:.3f}" for name, value in summary.get("validation", {}).items())
    state = "done" if summary.get("finished") else "stopped, the same command goes on"
    terminal.result(f"{folder}: {state}; {summary['samples']} samples; {figures}", folder=str(folder), **summary)

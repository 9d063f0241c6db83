"""`nlos train CONFIG`: train a learned method, alone or as one of several processes under torchrun."""

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.acquisition.errors import StorageError
from nlos.cli.contradictions import refuse_together
from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal
from nlos.configs.load import ConfigError, Loaded, load, where

if TYPE_CHECKING:
    from nlos.recon.training.train_settings import TrainSettings

LINE_S = 60.0
"""Off a terminal, a line so often."""


def train(
    config: Annotated[str, typer.Argument(metavar="CONFIG", help="A YAML file, or the name of one in configs/train.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Where the run lives; runs/train/NAME.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Everything but the training: is the file right, and what will it take?")
    ] = False,
    max_minutes: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this long; the same command resumes.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Begin again instead of resuming.")] = False,
) -> None:
    """Train a learned method; an interrupted run resumes from its last checkpoint."""
    from nlos.recon.training import train as training
    from nlos.recon.training.advice import advice
    from nlos.recon.training.memory import out_of_memory_in_words
    from nlos.recon.training.run_folder import STATE, WEIGHTS
    from nlos.recon.training.train_settings import TrainSettings
    from nlos.recon.weights.files import read_about

    refuse_together(
        "--check", {"--max-minutes": check and max_minutes is not None}, "nothing is trained", "Leave one of them out."
    )
    loaded = load("train", config, TrainSettings)
    _refuse_problems(loaded)
    settings = loaded.settings
    folder = output or Path("runs/train") / loaded.path.stem
    for line in advice(settings) if not _rank() else ():
        terminal.log(f"warning: {line}")
    if check:
        _say_trial(settings, folder, anew=overwrite)
        return
    if max_minutes is not None:
        settings = settings.model_copy(update={"max_minutes": max_minutes})
    seen = 0 if overwrite or not (folder / STATE).exists() else int(read_about(folder / STATE).get("step", 0))
    with Progress(settings.steps, seen, what="train", unit="steps", line_s=LINE_S) as progress:

        def say(line: str) -> None:
            progress.hide()
            terminal.log(line)
            progress.show()

        def told(step: int, steps: int, loss: float) -> None:
            progress.step(note=f", loss {loss:.4g}")

        try:
            with out_of_memory_in_words(settings):
                summary = training.train(settings, folder, say, progress=told, overwrite=overwrite)
        except StorageError as error:
            if (folder / STATE).exists():
                error.add_note(f"{folder / STATE} is as it was last saved: the same command goes on from there.")
            raise
    if _rank():
        return
    if "signal" in summary:
        number = summary["signal"]
        raise Stopped(
            ExitCode.INTERRUPTED if number == signal.SIGINT else ExitCode.TERMINATED,
            f"stopped by {signal.Signals(number).name} after step {summary['step']} of {settings.steps}, saved in "
            f"{folder}. The same command resumes.",
        )
    figures = ", ".join(f"{name} {value:.3f}" for name, value in summary.get("validation", {}).items())
    state = "done" if summary.get("finished") else "stopped; the same command resumes"
    terminal.result(
        f"{folder}: {state}; {summary['samples']} samples; at the end {figures}", folder=str(folder), **summary
    )
    if (best := summary.get("best")) is not None:
        terminal.result(
            f"{folder / WEIGHTS}: the best on validation, of step {best['step']} of {settings.steps}: "
            f"psnr {best['psnr']:.3f}"
        )


def _rank() -> int:
    """This process's number among those of torchrun: only the first one speaks."""
    return int(os.environ.get("RANK", "0"))


def _refuse_problems(loaded: "Loaded[TrainSettings]") -> None:
    """Raises `ConfigError` with the line of everything that would stop the training later."""
    from nlos.recon.training.checks import problems

    if found := problems(loaded.settings):
        if _rank():
            raise typer.Exit(int(ExitCode.USAGE))
        raise ConfigError("\n".join(f"{where(loaded, place)}: {what}" for place, what in found))


def _spoken(hours: float) -> str:
    if hours >= 1:
        return f"{hours:.1f} hours"
    return f"{60 * hours:.1f} minutes" if hours >= 1 / 60 else f"{3600 * hours:.0f} seconds"


def _say_trial(settings: "TrainSettings", folder: Path, anew: bool) -> None:
    from nlos.recon.training.memory import out_of_memory_in_words
    from nlos.recon.training.run_folder import STATE
    from nlos.recon.training.schedule import whole_batches
    from nlos.recon.training.trial import trial
    from nlos.recon.weights.files import read_about

    there = folder / STATE
    seen = int(read_about(there).get("samples", 0)) if there.exists() and not anew else 0
    with out_of_memory_in_words(settings):
        found = trial(settings, seen)
    resumes = f", {seen:,} of them seen" if seen else ""
    terminal.result(
        f"{settings.method}: {found['parameters']:,} parameters, {settings.samples:,} samples{resumes}"
        f"{whole_batches(settings)}"
    )
    terminal.result(
        f"{found['seconds_to_make_a_sample']:.2f} s to make a sample, {found['seconds_to_learn_from_it']:.2f} s to "
        f"learn from it, {found['seconds_of_validation']:.1f} s to validate, {found['peak_rss_mb']:.0f} MB; about "
        f"{_spoken(found['hours_left'])} to the end on this machine as busy as now",
        **found,
    )

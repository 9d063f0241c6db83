"""The folder of a training: its state to resume from, its weights to use, and whether both belong to these settings."""

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.writer_lock import WriterLock, has_no_locks
from nlos.recon.errors import InvalidSettings, ReconstructionFailed
from nlos.recon.training.architecture import method_settings
from nlos.recon.training.checkpoint import commit, optimiser_tensors, put_optimiser
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.described import parent_of, range_of
from nlos.recon.weights.files import put_weights, read_about, read_weights, save

STATE, WEIGHTS, LOG = "state.safetensors", "weights.safetensors", "log.jsonl"


@dataclass(frozen=True)
class BegunWith:
    """`before`: what the weights said of themselves that the run began with; `learned_from`: the fingerprints of scenes
    on disk."""

    before: Mapping[str, Any]
    learned_from: list[str]


def about_run(
    settings: TrainSettings,
    model: nn.Module,
    step: int,
    seconds: float,
    validation: Mapping[str, float],
    begun_with: BegunWith,
) -> dict[str, Any]:
    """What weights of this step say about themselves."""
    before = begun_with.before
    parent = {} if settings.start_from is None else {"parent": parent_of(settings.start_from)}
    return parent | {
        "method": settings.method,
        "architecture": method_settings(settings).model_dump(mode="json"),
        "range": range_of(settings.data.model_dump(mode="json")),
        "licence": settings.licence,
        "settings": settings.model_dump(mode="json", exclude={"cache"}),  # a place on one computer
        "validation": dict(validation),
        "learned_from": begun_with.learned_from,
        "step": step,
        "samples": step * settings.batch,
        "hours": seconds / 3600,
        "samples_before": before.get("samples", 0) + before.get("samples_before", 0),
        "hours_before": before.get("hours", 0.0) + before.get("hours_before", 0.0),
        "commit": commit(),
        "torch": torch.__version__,
        "device": str(next(model.parameters()).device),
        "threads": torch.get_num_threads(),
    }


def save_state(
    folder: Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    average: list[torch.Tensor],
    about: Mapping[str, Any],
) -> None:
    """All that the next step needs."""
    state = {f"weights/{name}": p.detach() for name, p in model.named_parameters()}
    state |= {f"average/{name}": p for name, p in _averaged(model, average).items()}
    save(folder / STATE, state | optimiser_tensors(model, optimiser), about)


def save_weights(folder: Path, model: nn.Module, average: list[torch.Tensor], about: Mapping[str, Any]) -> None:
    """Every parameter, those that were trained as their running mean."""
    whole = {name: p.detach() for name, p in model.named_parameters()}
    save(folder / WEIGHTS, whole | _averaged(model, average), about)


def keep_best(
    folder: Path, model: nn.Module, average: list[torch.Tensor], about: dict[str, Any], judged: bool = True
) -> None:
    """The weights to use become these where validation finds them better than those before, or is no judge of them.

    The light cone's figures on the same scenes are known at the end alone: the best weights get them then, and the
    last figures of the run.
    """
    path, figures = folder / WEIGHTS, about["validation"]
    ended = {"last": {"samples": about["samples"], **figures}} if "lct_psnr" in figures else {}
    best = read_about(path).get("validation", {}) if path.exists() else {}
    if not judged or not figures["psnr"] < best.get("psnr", -math.inf):
        save_weights(folder, model, average, about | ended)
    elif ended:
        held = read_weights(path)
        lct = figures["lct_psnr"]
        save(path, held.tensors, held.about | ended | {"licence": about["licence"], "validation": {
            **best, "lct_psnr": lct, "margin_db": best["psnr"] - lct}})  # fmt: skip


def ended_run(folder: Path, settings: TrainSettings, step: int) -> dict[str, Any] | None:
    """The summary of a run that is over and stays as it is; None where something is left to do."""
    log = folder / LOG
    if step < settings.steps or not (log.exists() and (folder / WEIGHTS).exists()):
        return None
    last = log.read_text(encoding="utf-8").splitlines()[-1:]
    summary = json.loads(last[0]) if last and last[0].endswith("}") else {}
    if not summary.get("finished") or read_about(folder / WEIGHTS).get("licence") != settings.licence:
        return None
    return dict(summary)


def best_of(folder: Path) -> dict[str, Any]:
    """Of the weights in `folder`: their step and what validation found."""
    about = read_about(folder / WEIGHTS)
    return {"step": about["step"], "samples": about["samples"], **about["validation"]}


def _averaged(model: nn.Module, average: list[torch.Tensor]) -> dict[str, torch.Tensor]:
    trained = [name for name, p in model.named_parameters() if p.requires_grad]
    return dict(zip(trained, average, strict=True))


def resume_run(
    settings: TrainSettings,
    folder: Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    average: list[torch.Tensor],
    learned_from: list[str],
) -> tuple[int, float]:
    """Step and seconds spent of the run in `folder`, its state put in place; 0, 0 where there is none."""
    if not (folder / STATE).exists():
        return 0, 0.0
    state = read_weights(folder / STATE)
    _refuse_changes(TrainSettings.model_validate_json(json.dumps(state.about["settings"])), settings, folder)
    others = set(state.about.get("learned_from", ())) ^ set(learned_from)
    if others:
        raise InvalidSettings(
            f"{folder} holds a run on other scenes: {len(others)} of what data.files finds were added, changed or "
            "removed. Put them back, choose another folder with -o, or use --overwrite to begin again."
        )
    if settings.steps < int(state.about["step"]):
        raise InvalidSettings(
            f"samples: {folder} has seen {state.about['samples']:,} already. Ask for as many or more, "
            "or choose another folder."
        )

    def under(prefix: str) -> dict[str, torch.Tensor]:
        return {name.removeprefix(prefix): x for name, x in state.tensors.items() if name.startswith(prefix)}

    put_weights(model, under("weights/"), str(folder / STATE))
    put_optimiser(model, optimiser, state.tensors)
    mean = under("average/")
    names = [name for name, p in model.named_parameters() if p.requires_grad]
    for name, own in zip(names, average, strict=True):
        own.copy_(mean[name])
    return int(state.about["step"]), 3600 * float(state.about["hours"])


HARMLESS = ("samples", "max_minutes", "checkpoint_minutes", "tensorboard", "cache", "licence", "workers")
"""What may change when a training is resumed. More samples stretch its schedule: a finished run
resumes from its end."""


def _refuse_changes(before: TrainSettings, now: TrainSettings, folder: Path) -> None:
    """Raises `InvalidSettings` naming every other setting that is not what it was, and what it was."""
    was, is_ = (_flat(one.model_dump(mode="json", exclude=set(HARMLESS))) for one in (before, now))
    changed = [f"{key} was {was.get(key)}, now {is_.get(key)}" for key in sorted(was.keys() | is_.keys())
               if was.get(key) != is_.get(key)]  # fmt: skip
    if changed:
        raise InvalidSettings(
            f"{folder} holds a run with other settings: {'; '.join(changed)}. Choose another folder with -o, put them "
            "back, or use --overwrite to begin again."
        )


def _flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Nested settings by their dotted names."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= _flat(value, f"{above}{key}.") if isinstance(value, dict) else {f"{above}{key}": value}
    return found


def not_finite(what: str, folder: Path, step: int, steps: int) -> ReconstructionFailed:
    """Why a training cannot continue, and what is left of it."""
    kept = (
        f"{folder / WEIGHTS} holds the last good weights" if (folder / WEIGHTS).exists() else "there are no weights yet"
    )
    return ReconstructionFailed(
        f"{what} at step {step + 1} of {steps}; {kept}. Lower learning_rate or clip, or set precision: float32, and "
        "train into another folder."
    )


@contextmanager
def alone_in(folder: Path, rank: int) -> Iterator[None]:
    """The only training in `folder`, as long as this lasts. Raises InvalidSettings where another process trains, and
    StorageError where nothing can be written."""
    if rank:
        yield
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = WriterLock(folder / "training")
    except OSError as error:
        cause = error.__cause__ if isinstance(error, StorageError) else error
        if isinstance(cause, OSError):
            if has_no_locks(cause):
                raise
            why = f"nothing can be written there ({cause.strerror})"
            raise StorageError(f"{folder}: {why}. Choose another folder with -o.") from error
        raise InvalidSettings(
            f"{folder}: another process trains there. Wait for it, or choose another folder with -o."
        ) from error
    try:
        for name in (STATE, WEIGHTS):  # of a training that was killed as it saved
            for left in folder.glob(f"{Path(name).stem}.*.partial"):
                left.unlink(missing_ok=True)
        yield
    finally:
        lock.release()

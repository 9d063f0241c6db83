"""The log of a training, one JSON line at a time, and the same as a table."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.recon.training.curves import write_table


class Log:
    """The JSONL log; lines written after the checkpoint that a run resumes from are dropped."""

    def __init__(self, path: Path, step: int, active: bool, tensorboard: bool = False):
        self.path, self.active = path, active
        self.sums: dict[str, float] = {}
        self.count = 0
        self.board = _board(path.parent, step) if active and tensorboard else None
        if active:
            path.parent.mkdir(parents=True, exist_ok=True)
            lines = path.read_text().splitlines() if path.exists() else []
            kept = [line for line in lines if line.endswith("}") and step and json.loads(line)["step"] <= step]
            if kept != lines or not path.exists():  # replaced at once: a kill at this moment loses no line
                fresh = path.with_name(f".{path.name}.new")
                with told_of(path, fresh):
                    fresh.write_text("".join(line + "\n" for line in kept))
                    fresh.replace(path)

    def terms(
        self, step: int, terms: Mapping[str, float], rate: float, norm: float, seconds: float, every: int
    ) -> None:
        for name, value in terms.items():
            self.sums[name] = self.sums.get(name, 0.0) + value
        self.count += 1
        if step % every == 0:
            means = {name: value / self.count for name, value in self.sums.items()}
            self.line({"step": step, **means, "rate": rate, "gradient_norm": norm, "seconds": seconds})
            self.sums, self.count = {}, 0

    def line(self, values: Mapping[str, Any]) -> None:
        if self.active:
            with told_of(self.path, self.path), self.path.open("a") as file:
                file.write(json.dumps(values) + "\n")
            write_table(self.path)
        if self.board is not None:
            shown = {**values, **values.get("validation", {})}
            for name, value in shown.items():
                if isinstance(value, float):
                    self.board.add_scalar(name, value, values["step"])
            self.board.flush()


def _board(folder: Path, step: int) -> Any:
    """A TensorBoard writer that continues after `step`. Raises ValueError where TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise ValueError("tensorboard: true needs TensorBoard: pip install 'nlos[tensorboard]'") from error
    return SummaryWriter(str(folder / "tensorboard"), purge_step=step)


def finished(folder: Path) -> dict[str, float] | None:
    """What the finished run in `folder` reached on its validation scenes; None where there is none."""
    log = folder / "log.jsonl"
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    summaries = [json.loads(line) for line in lines if '"finished": true' in line]
    return dict(summaries[-1]["validation"]) if summaries else None

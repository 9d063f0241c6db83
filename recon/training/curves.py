"""What a training's log says, for people: loss.png with a panel a curve, and log.csv for every other program."""

import csv
import json
import math
import time
from pathlib import Path
from typing import Any

from nlos.acquisition.recording.disk_refusal import told_of
from nlos.recon.own_style import own_style
from nlos.recon.png import write_png

VALIDATED = "validation "
SMOOTHED = 20
NO_CURVES = (
    "step", "seconds", "samples", "minutes", "finished", "data_wait", f"{VALIDATED}lct_psnr", f"{VALIDATED}margin_db",
)  # fmt: skip
"""Known at the end alone; the light cone's PSNR is a line beside the network's."""


def curves_of(log: Path) -> dict[str, tuple[list[int], list[float]]]:
    """Name -> steps and values, from log.jsonl: the loss and its terms, validation, rate and gradient norm."""
    found: dict[str, tuple[list[int], list[float]]] = {}
    for row in rows_of(log):
        for name, value in row.items():
            if name not in NO_CURVES and isinstance(value, int | float):
                steps, values = found.setdefault(name, ([], []))
                steps.append(int(row["step"]))
                values.append(float(value))
    return found


def rows_of(log: Path) -> list[dict[str, Any]]:
    """A row a step, of all the log's lines about it; what validation found is `validation NAME`."""
    rows: dict[int, dict[str, Any]] = {}
    for line in log.read_text(encoding="utf-8").splitlines():
        if line.endswith("}"):
            row = json.loads(line)
            checked = {f"{VALIDATED}{name}": value for name, value in row.pop("validation", {}).items()}
            row.pop("best", None)
            rows[row["step"]] = {**rows.get(row["step"], {}), **row, **checked}
    return [rows[step] for step in sorted(rows)]


def last_rate_of(log: Path) -> float | None:
    """The learning rate of the last step that the log tells of; None where there is none."""
    rates = [row["rate"] for row in rows_of(log) if "rate" in row] if log.exists() else []
    return float(rates[-1]) if rates else None


def smoothed(values: list[float]) -> list[float]:
    """Each value with those around it, a `SMOOTHED`th of all on each side: their mean, of those that are finite."""
    around = max(1, len(values) // SMOOTHED)
    found = []
    for place in range(len(values)):
        near = [value for value in values[max(0, place - around) : place + around + 1] if math.isfinite(value)]
        found.append(sum(near) / len(near) if near else math.nan)
    return found


def write_table(log: Path) -> None:
    """log.csv beside the log, replaced at once."""
    rows = rows_of(log)
    names = list(dict.fromkeys(name for row in rows for name in row))
    fresh, table = log.with_name(".log.csv.new"), log.with_name("log.csv")
    with told_of(table, fresh):
        with fresh.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(rows)
        fresh.replace(table)


class Redrawn:
    """loss.png while a training goes on: a tenth of the time goes into it, at most."""

    def __init__(self, log: Path) -> None:
        self._log, self._due_s = log, -math.inf

    def again(self) -> None:
        """Draws what has come, unless it was drawn lately."""
        began_s = time.monotonic()
        if began_s >= self._due_s:
            draw(self._log)
            self._due_s = time.monotonic() + 9 * (time.monotonic() - began_s)


@own_style()
def draw(log: Path) -> None:
    """loss.png beside the log, replaced at once."""
    from matplotlib.figure import Figure

    rows, curves = rows_of(log), curves_of(log)
    if not curves:
        return
    columns = min(3, len(curves))
    lines = -(-len(curves) // columns)
    figure = Figure(figsize=(4.2 * columns, 2.4 * lines), layout="constrained")
    for place, (name, (steps, values)) in enumerate(curves.items(), 1):
        axes = figure.add_subplot(lines, columns, place, title=name, xlabel="step")
        few = len(steps) < 2 * SMOOTHED or name == "rate"  # as it is: nothing in it is noise
        axes.plot(
            steps, values, marker="." if len(steps) < 2 * SMOOTHED else None, linewidth=0.9, alpha=1.0 if few else 0.35
        )
        if not few:
            axes.plot(steps, smoothed(values), color="C0", linewidth=1.6)
        finite = [value for value in values if math.isfinite(value)]
        rivals = [row[f"{VALIDATED}lct_psnr"] for row in rows if f"{VALIDATED}lct_psnr" in row]
        if name == f"{VALIDATED}psnr" and rivals:
            axes.axhline(rivals[-1], color="0.5", linestyle="--", label="light cone")
            axes.legend(fontsize=7)
        if not name.startswith(VALIDATED) and finite and min(finite) > 0 and max(finite) > 20 * min(finite):
            axes.set_yscale("log")
        axes.grid(alpha=0.3)
    picture = log.with_name(".loss.new.png")
    write_png(figure, picture, 110)
    picture.replace(log.with_name("loss.png"))

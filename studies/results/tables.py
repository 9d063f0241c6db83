"""Tables of results in Markdown: quality by condition and scene, margins, and what training cost."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from nlos.recon.weights.files import place_of, read_weights

Row = dict[str, Any]
RIVAL = "lct"


class Column(NamedTuple):
    """How a figure of the rows is shown."""

    title: str
    factor: float
    digits: int
    higher_is_better: bool = False


FIGURES = {
    "psnr": Column("PSNR at the best scale, dB", 1, 2, True),
    "psnr_max": Column("PSNR of pictures over their maximum, dB", 1, 2, True),
    "ssim": Column("SSIM", 1, 3, True),
    "corr": Column("correlation", 1, 3, True),
    "depth_rmse_m": Column("root mean square depth error, mm", 1e3, 1),
    "depth_mad_m": Column("mean absolute depth error, mm", 1e3, 1),
    "depth_median_abs_m": Column("median absolute depth error, mm", 1e3, 1),
    "depth_missing": Column("pixels without depth, %", 100, 1),
    "seconds": Column("seconds a scan", 1, 2),
}


def unique(values: Iterable[str]) -> list[str]:
    """Each once, in the order of appearance."""
    return list(dict.fromkeys(values))


def pick(rows: Iterable[Row], **wanted: str) -> list[Row]:
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def mean(rows: Iterable[Row], figure: str) -> float | None:
    """Over the rows that have the figure; None where none has."""
    values = [row[figure] for row in rows if row.get(figure) is not None and row[figure] == row[figure]]
    return fmean(values) if values else None


def of(rows: Iterable[Row], method: str, condition: str, figure: str) -> float | None:
    """The mean of one figure over the scenes."""
    return mean(pick(rows, method=method, condition=condition), figure)


def shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def by_condition(rows: Sequence[Row], figure: str) -> str:
    """Means over scenes, one line a method, one column a condition."""
    methods, conditions = unique(r["method"] for r in rows), unique(r["condition"] for r in rows)
    column = FIGURES[figure]
    body = []
    for method in methods:
        means = [of(rows, method, condition, figure) for condition in conditions]
        body.append(
            [method, *(shown(None if value is None else column.factor * value, column.digits) for value in means)]
        )
    return table([column.title, *conditions], body)


def margins(rows: Sequence[Row]) -> str:
    """PSNR over the light-cone transform's at its best snr, one line a method."""
    conditions = unique(r["condition"] for r in rows)
    body = []
    for method in unique(r["method"] for r in rows):
        line = [method]
        for condition in conditions:
            own, rival = (of(rows, m, condition, "psnr") for m in (method, RIVAL))
            line.append("-" if own is None or rival is None else f"{own - rival:+.2f}")
        body.append(line)
    return table([f"margin over {RIVAL}, dB", *conditions], body)


def at_a_glance(rows: Sequence[Row], method: str = "nano") -> str:
    """One line a condition: the rival, the method, what lies between them, and the method's shape and depths."""
    body = []
    for condition in unique(r["condition"] for r in rows):
        rival, own, ssim, depth_m = (
            of(rows, RIVAL, condition, "psnr"),
            *(of(rows, method, condition, figure) for figure in ("psnr", "ssim", "depth_mad_m")),
        )
        margin = "-" if own is None or rival is None else f"{own - rival:+.1f}"
        depth = None if depth_m is None else 1e3 * depth_m
        body.append([condition, shown(rival, 1), shown(own, 1), margin, shown(ssim, 3), shown(depth, 1)])
    heads = [f"{RIVAL}, dB", f"{method}, dB", "margin, dB", f"{method}, SSIM", f"{method}, depth off by, mm"]
    return table(["condition", *heads], body)


def by_scene(rows: Sequence[Row], condition: str) -> str:
    """PSNR of one condition, one line a scene, one column a method."""
    methods, chosen = unique(r["method"] for r in rows), pick(rows, condition=condition)
    body = [
        [scene, *(shown(mean(pick(chosen, method=m, scene=scene), "psnr"), 2) for m in methods)]
        for scene in unique(r["scene"] for r in chosen)
    ]
    return table([f"PSNR, {condition}", *methods], body)


def settings(rows: Sequence[Row]) -> str:
    """What each method ran with: its snr by condition where it has one, and whatever else it was given."""
    conditions = unique(r["condition"] for r in rows)
    body = []
    for method in unique(r["method"] for r in rows):
        line = [method]
        for condition in conditions:
            first = (pick(rows, method=method, condition=condition) or [{}])[0].get("settings", {})
            line.append("-" if first.get("snr") is None else f"{first['snr']:g}")
        some = pick(rows, method=method)[0].get("settings", {})
        rest = ", ".join(f"{key} {value}" for key, value in some.items() if key != "snr" and value is not None)
        body.append([*line, rest])
    return table(["snr", *conditions, "other settings"], body)


def comparison(rows: Sequence[Row], method: str, rivals: Sequence[str], figures: Sequence[str]) -> tuple[str, str]:
    """Where `method` is better than its rivals: a table of differences, and the cells where it is not, in words."""
    conditions = unique(r["condition"] for r in rows)
    body, worse = [], []
    for figure in figures:
        column = FIGURES[figure]
        for rival in rivals:
            line = [f"{column.title}, against {rival}"]
            for condition in conditions:
                own, other = (of(rows, m, condition, figure) for m in (method, rival))
                if own is None or other is None:
                    line.append("-")
                    continue
                difference = column.factor * (own - other)
                good = difference >= 0 if column.higher_is_better else difference <= 0
                line.append(f"{difference:+.{column.digits}f}{'' if good else ' worse'}")
                if not good:
                    worse.append(f"{column.title} against {rival} at {condition}")
            body.append(line)
    return table([f"{method} minus rival", *conditions], body), "; ".join(worse)


def samples_seen(method: str, folder: Path | None = None) -> int | None:
    """How many samples the weights of a method were trained on; None without weights."""
    path = place_of(method) if folder is None else folder / f"{method}.safetensors"
    if not path.exists():
        return None
    about = read_weights(path).about
    return int(about["samples"] + about.get("samples_before", 0))


def training(methods: Iterable[str], folder: Path | None = None) -> str:
    """What the shipped weights of these methods cost: parameters, samples seen, hours, validation."""
    body = []
    for method in methods:
        path = place_of(method) if folder is None else folder / f"{method}.safetensors"
        if not path.exists():
            body.append([method, "not trained yet", "-", "-", "-", "-", "-"])
            continue
        weights = read_weights(path)
        about = weights.about
        count = sum(tensor.numel() for tensor in weights.tensors.values())
        found = about.get("validation", {}).get("psnr")
        where = f"{about.get('device', '-')}, threads: {about.get('threads', '-')}"
        hours = about["hours"] + about.get("hours_before", 0.0)
        line = [method, f"{count:,}", f"{samples_seen(method, folder):,}", f"{hours:.2f}", where, shown(found, 2)]
        body.append([*line, f"{path.stat().st_size / 1e6:.1f}"])
    return table(["training", "parameters", "samples seen", "hours", "on", "validation PSNR, dB", "MB"], body)

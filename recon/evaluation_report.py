"""results.json, results.csv, results.md and gallery.png: what `nlos evaluate` leaves behind."""

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TextIO, TypeVar

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nlos.recon.evaluate import Evaluation, Row, as_json
from nlos.recon.own_style import own_style
from nlos.recon.pixel_marks import outline
from nlos.recon.png import write_png
from nlos.recon.results import software
from nlos.recon.seen import visible_depth
from nlos.recon.small_print import drawable
from nlos.recon.truth_scenes import Scene
from nlos.recon.whole_files import whole_files

T = TypeVar("T")
NAMES = ("results.json", "results.csv", "results.md", "gallery.png")
COLUMNS: tuple[tuple[str, str, float, str], ...] = (
    ("psnr", "PSNR, dB", 1, "{:.2f}"),
    ("ssim", "SSIM", 1, "{:.3f}"),
    ("psnr_max", "PSNR max, dB", 1, "{:.2f}"),
    ("ssim_max", "SSIM max", 1, "{:.3f}"),
    ("corr", "corr", 1, "{:.3f}"),
    ("depth_rmse_m", "depth RMSE, mm", 1e3, "{:.1f}"),
    ("depth_mad_m", "depth MAD, mm", 1e3, "{:.1f}"),
    ("depth_median_abs_m", "depth median, mm", 1e3, "{:.1f}"),
    ("depth_missing", "no depth, %", 100, "{:.1f}"),
    ("explained", "explained, %", 100, "{:.0f}"),
    ("seconds", "s", 1, "{:.2f}"),
    ("peak_rss_mb", "peak MB", 1, "{:.0f}"),
)
SURE: tuple[tuple[str, str, float, str], ...] = (
    ("albedo_coverage", "albedo holds, %", 100, "{:.1f}"),
    ("albedo_width", "width", 1, "{:.3f}"),
    ("albedo_ause", "AUSE", 1, "{:.3f}"),
    ("depth_coverage", "depth holds, %", 100, "{:.1f}"),
    ("depth_width_m", "width, mm", 1e3, "{:.1f}"),
    ("depth_ause", "AUSE", 1, "{:.3f}"),
    ("seen_ece", "ECE of seen", 1, "{:.3f}"),
)


def write_evaluation(folder: Path, evaluation: Evaluation, overwrite: bool = False) -> list[Path]:
    """Writes the four files and returns their paths. Raises FileExistsError unless `overwrite`."""
    paths = [folder / name for name in NAMES]
    for path in paths:
        if path.exists() and not overwrite:
            raise FileExistsError(f"{path} exists. Choose another folder, or use --overwrite.")
    with whole_files(folder, new=not overwrite) as fresh:
        rows, sheet, words, drawn = (fresh / name for name in NAMES)
        rows.write_text(json.dumps(as_json(evaluation.rows), indent=1) + "\n", encoding="utf-8")
        with sheet.open("w", newline="", encoding="utf-8") as file:
            write_csv(evaluation.rows, file)
        words.write_text(table(evaluation), encoding="utf-8")
        gallery(evaluation, drawn)
    return paths


def write_csv(rows: Sequence[Row], file: TextIO) -> None:
    """The rows as a table for spreadsheets: those of results.json, settings as JSON, empty where there is none."""
    table_of = csv.DictWriter(file, [field.name for field in fields(Row)])
    table_of.writeheader()
    table_of.writerows(row | {"settings": json.dumps(row["settings"])} for row in as_json(list(rows)))


def table(evaluation: Evaluation) -> str:
    """Means over the scenes for each condition and method, then every scene, as Markdown. A mean of fewer scenes than
    others', for a method that failed on some, says so."""
    rows = evaluation.rows
    names = ", ".join(scene.name for scene in evaluation.scenes)
    lines = [
        "# Methods on scenes with ground truth",
        "",
        f"Scenes: {names}. PSNR and SSIM on the full image, truth divided by its maximum, prediction by its best",
        "least-squares scale; `max`: prediction divided by its own maximum, as papers do. `corr`: correlation with the",
        "truth. Depth over the truth's mask, where a depth was found. Means over the scenes. `snr` is the best of 1,",
        "0.1, 0.03, 0.01 and 0.003 for that condition, where the method has an inverse filter and none was given.",
        f"Software: {software()}.",
        "",
        *(f"**{note.removesuffix('.')}.**\n" for note in evaluation.notes),
    ]
    for condition in _unique(row.condition for row in rows):
        lines += [f"## {condition}", "", _header("method", "settings")]
        of_it = [row for row in rows if row.condition == condition]
        most = len({row.scene for row in of_it})
        for method in _unique(row.method for row in of_it):
            chosen = [row for row in of_it if row.method == method]
            fewer = "" if len(chosen) == most else f" ({len(chosen)} of {most} scenes)"  # no figure beside the others
            lines.append(_line([f"{method}{fewer}", _settings(chosen[0])], chosen))
        lines.append("")
    lines += sure_table(rows)
    lines += ["## Every scene", "", _header("condition", "scene", "method")]
    for row in rows:
        lines.append(_line([row.condition, row.scene, row.method], [row]))
    return "\n".join(lines) + "\n"


def sure_table(rows: list[Row]) -> list[str]:
    """How good the intervals are, of the methods that have them; empty where none has."""
    knowing = [row for row in rows if np.isfinite(row.seen_ece)]
    if not knowing:
        return []
    titles = ("condition", "method", *(title for _, title, _, _ in SURE))
    lines = [
        "## How sure",
        "",
        "90 % intervals over the truth's mask: how often they hold, how wide they are, and the area between the",
        "sparsification curves by width and by error, over the error's range; the calibration error of `seen`.",
        "",
        "| " + " | ".join(titles) + " |\n|" + "---|" * len(titles),
    ]
    for condition, method in _unique((row.condition, row.method) for row in knowing):
        of = [row for row in knowing if (row.condition, row.method) == (condition, method)]
        figures = [form.format(_mean(of, key) * factor) for key, _, factor, form in SURE]
        lines.append("| " + " | ".join([condition, method, *figures]) + " |")
    return [*lines, ""]


@own_style()
def gallery(evaluation: Evaluation, path: Path) -> None:
    """Front views and depths: a line a scene and condition, the truth first, then a column a method. Yellow is near,
    dark blue far; beside each line stands where its colours end."""
    methods = _unique(row.method for row in evaluation.rows)
    pairs = _unique((row.condition, row.scene) for row in evaluation.rows)
    truth = {scene.name: scene for scene in evaluation.scenes}
    columns = 2 * (1 + len(methods))
    figure = Figure(figsize=(1.15 * columns, 1.15 * len(pairs) + 0.5), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0, hspace=0)  # type: ignore[union-attr, call-arg]
    grid = figure.subplots(len(pairs), columns, squeeze=False)
    for line, (condition, name) in zip(grid, pairs, strict=True):
        scene = truth[name]
        span = depth_span_m(scene)
        _intensity(line[0], scene.intensity)
        _depth(line[1], np.where(scene.mask, scene.depth_m, np.nan), span)
        line[0].set_ylabel(
            f"{drawable(name)}\n{condition}\ndepth {span[0]:.2f} to {span[1]:.2f} m", fontsize=6, parse_math=False
        )
        for k, method in enumerate(methods, start=1):
            picture = evaluation.pictures.get((name, method, condition))
            if picture is None:
                line[2 * k].axis("off")
                line[2 * k + 1].axis("off")
                continue
            _intensity(line[2 * k], picture.albedo)
            _depth(line[2 * k + 1], visible_depth(picture), span)
    for k, title in enumerate(["truth", *methods]):
        grid[0][2 * k].set_title(drawable(title), fontsize=8, parse_math=False)
        grid[0][2 * k + 1].set_title("depth", fontsize=8)
    write_png(figure, path, 110)


def depth_span_m(scene: Scene) -> tuple[float, float]:
    """The ends of the depth colours in a scene's line of the gallery: 5 cm beyond its true depths."""
    seen = scene.depth_m[scene.mask]
    return (float(seen.min()) - 0.05, float(seen.max()) + 0.05) if seen.size else (0.0, 1.0)


def _intensity(axes: Axes, image: npt.NDArray[np.float32]) -> None:
    top = float(np.quantile(image, 0.999)) or 1.0
    axes.imshow(image, cmap="gray", vmin=0, vmax=top, interpolation="nearest")
    axes.set(xticks=[], yticks=[])


def _depth(axes: Axes, depth_m: npt.NDArray[np.float32], span: tuple[float, float]) -> None:
    colours = matplotlib.colormaps["viridis_r"].with_extremes(bad="0.85")
    axes.imshow(np.ma.masked_invalid(depth_m), cmap=colours, vmin=span[0], vmax=span[1], interpolation="nearest")
    rows, cols = depth_m.shape
    outline(axes, np.isfinite(depth_m), (-0.5, cols - 0.5, rows - 0.5, -0.5))
    axes.set(xticks=[], yticks=[])


def _unique(items: Iterable[T]) -> list[T]:
    return list(dict.fromkeys(items))


def _settings(row: Row) -> str:
    told = {key: value for key, value in row.settings.items() if value is not None}
    if "weights" in told:  # which know the architecture
        told = {key: told[key] for key in ("weights", "snr", "falloff", "response") if key in told}
    return ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in told.items()
    )


def _mean(rows: list[Row], key: str) -> float:
    values = np.array([float(getattr(row, key)) for row in rows])
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def _header(*first: str) -> str:
    titles = [*first, *(title for _, title, _, _ in COLUMNS)]
    return "| " + " | ".join(titles) + " |\n|" + "---|" * len(titles)


def _line(first: list[str], rows: list[Row]) -> str:
    cells = [form.format(_mean(rows, key) * factor) for key, _, factor, form in COLUMNS]
    return "| " + " | ".join([*first, *cells]) + " |"

"""One picture a correction: before, after, and what is left."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.calibration.alignment import align
from nlos.calibration.detector import subtract_dark, undo_dead_time
from nlos.recon.own_style import own_style
from nlos.recon.png import is_own, refuse_to_replace_another, write_png
from nlos.recon.whole_files import whole_files
from nlos.report.spots_picture import draw_spots

if TYPE_CHECKING:
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import CorrectedPoints
    from nlos.calibration.geometry_fit import Spots
    from nlos.calibration.measure import Measurement
    from nlos.calibration.raw_points import RawPoints

Floats = npt.NDArray[np.float64]
SHOWN_S = 3e-9
NAMES = ("time_offset", "background", "direct_light", "dead_time", "wall", "spots")


def folder_of_pictures(constants: Path) -> Path:
    """Where the pictures of the constants in that file go: beside it."""
    return constants.with_suffix("") if constants.suffix else constants.with_name(f"{constants.name}-pictures")


def refuse_to_replace(folder: Path, overwrite: bool) -> None:
    """Raises `FileExistsError` where a file is at the folder's place, and where what is at the place of a picture is a
    folder, or none of this program's and not to be replaced."""
    if folder.exists() and not folder.is_dir():
        raise FileExistsError(f"{folder}: is a file, where a folder of pictures would go. Choose another name with -o.")
    for name in NAMES:
        refuse_to_replace_another(folder / f"{name}.png", overwrite)


@contextmanager
def pictures_of(found: "Measurement", folder: Path, spots: "Spots | None" = None) -> Iterator[list[Path]]:
    """Draws what `found` holds. The pictures, whose paths it gives, take their places in `folder`, and those of earlier
    ones, when the block ends, and none of them where that fails."""
    raw, corrected = found.raw, found.corrected
    if raw is None or corrected is None:
        yield []
        return
    from matplotlib.figure import Figure

    pictures: list[tuple[str, Callable[[Any], None]]] = [
        ("time_offset", lambda axes: _draw_time_offset(axes, raw, corrected)),
        ("background", lambda axes: _draw_background(axes, raw, corrected, found.constants)),
        ("direct_light", lambda axes: _draw_direct_light(axes, raw, corrected)),
    ]
    if found.constants.dead_time_s is not None and raw.period_s is not None:
        pictures.append(("dead_time", lambda axes: _draw_dead_time(axes, raw, found.constants)))
    if found.geometry is not None:
        pictures.append(("wall", lambda axes: _draw_wall(axes, found)))
    earlier = [f"{name}.png" for name in NAMES if is_own(folder / f"{name}.png")]
    with whole_files(folder, earlier) as fresh:
        with own_style():
            for name, draw in pictures:
                figure = Figure(figsize=(15, 4.5), layout="constrained")
                axes = figure.subplots(1, 3)
                draw(axes)
                for panel, title in zip(axes, ("before", "after", "residual"), strict=True):
                    panel.set_title(f"{title}: {panel.get_title()}" if panel.get_title() else title)
                write_png(figure, fresh / f"{name}.png", 100)
            if spots is not None and found.geometry is not None:
                write_png(draw_spots(found.geometry, spots, (raw.x_m, raw.y_m)), fresh / "spots.png", 110)
        yield [folder / f"{name}.png" for name in NAMES if (fresh / f"{name}.png").exists()]


def _map(panel: Any, raw: "RawPoints", values: Floats, label: str, symmetric: bool = False) -> None:
    """A coloured dot at every point of the wall; darker is less, so that a sign is seen without colours, too."""
    limit = float(np.nanquantile(np.abs(values), 0.99)) if np.isfinite(values).any() else 1.0
    style = {"vmin": -limit, "vmax": limit} if symmetric else {}
    size = (260 / max(np.sqrt(len(values)), 4)) ** 2
    dots = panel.scatter(raw.x_m, raw.y_m, c=values, s=size, marker="s", cmap="viridis", **style)
    panel.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    panel.figure.colorbar(dots, ax=panel, label=label)


def _draw_time_offset(axes: Any, raw: "RawPoints", corrected: "CorrectedPoints") -> None:
    offsets = corrected.offsets
    assert offsets is not None

    width_ns = raw.time.bin_width_s * 1e9
    order = np.argsort(raw.y_m * 1e6 + raw.x_m)[:: max(1, len(raw.counts) // 1024)]
    first, last = np.nanquantile(offsets.offset_bins, [0, 1])
    low, high = max(int(first) - 20, 0), min(int(last + SHOWN_S / raw.time.bin_width_s), raw.time.bins)
    start_ns = raw.time.start_s * 1e9
    before = np.log10(raw.counts[order, low:high].astype(np.float64) + 0.3)
    edges = (start_ns + low * width_ns, start_ns + high * width_ns, len(order), 0)
    axes[0].imshow(before, aspect="auto", extent=edges, cmap="magma", interpolation="nearest")
    axes[0].set(xlabel="time after sync (ns)", ylabel="points", title="recorded counts (log)")
    shown = min(int(SHOWN_S / raw.time.bin_width_s), corrected.time.bins)
    after = np.log10(align(raw.counts[order], np.nan_to_num(offsets.offset_bins[order]), shown) + 0.3)
    axes[1].imshow(
        after, aspect="auto", extent=(0, shown * width_ns, len(order), 0), cmap="magma", interpolation="nearest"
    )
    axes[1].set(xlabel="time after the direct arrival (ns)", ylabel="points", title="aligned to the direct arrival")
    _map(axes[2], raw, offsets.residual_bins * width_ns * 1e3, "arrival less the wall's fit (ps)", symmetric=True)


def _draw_background(axes: Any, raw: "RawPoints", corrected: "CorrectedPoints", constants: "BenchConstants") -> None:
    offsets = corrected.offsets
    assert offsets is not None
    end = np.clip(np.nan_to_num(offsets.offset_bins) - 20, 1, raw.time.bins).astype(int)
    lit = subtract_dark(undo_dead_time(raw, constants)[0], raw, constants)
    mean, left = (
        np.array([row[:n].mean(dtype=np.float64) for row, n in zip(counts, end, strict=True)])
        for counts in (raw.counts, lit)
    )
    left -= corrected.background.per_bin
    _map(axes[0], raw, mean, "counts per bin before the pulse")
    _map(axes[1], raw, left, "the same, background subtracted", symmetric=True)
    sigma = left / np.sqrt(np.maximum(mean.mean(), 1e-12) / end)
    axes[2].hist(sigma, bins=np.linspace(-5, 5, 51), density=True)
    normal = np.linspace(-5, 5, 201)
    axes[2].plot(normal, np.exp(-0.5 * normal**2) / np.sqrt(2 * np.pi))
    axes[2].set(xlabel="what is left, in standard deviations", title="against chance alone")


def _draw_direct_light(axes: Any, raw: "RawPoints", corrected: "CorrectedPoints") -> None:
    time_ns = corrected.time.centres_s() * 1e9
    model = corrected.direct.amplitude.mean() * corrected.direct.shape
    after = corrected.counts.mean(axis=0, dtype=np.float64)
    end = corrected.direct.end_bin
    whole = after + model
    floor = max(1e-6, float(np.median(np.abs(after[end:])) / 10)) if end < len(after) else 1e-6
    axes[0].semilogy(time_ns, np.maximum(whole, floor), label="counts per point")
    axes[0].semilogy(time_ns, np.maximum(model, floor), label="model of the direct light")
    axes[0].axvspan(0, end * corrected.time.bin_width_s * 1e9, alpha=0.2, label="masked")
    axes[0].set(xlabel="time after the direct arrival (ns)", title="mean over all points")
    axes[0].legend()
    axes[1].plot(time_ns, after)
    axes[1].set(xlabel="time after the direct arrival (ns)", title="mean counts per point")
    late = slice(end + int(0.5e-9 / corrected.time.bin_width_s))
    sums, variance = (
        each[:, late].sum(axis=1, dtype=np.float64, where=corrected.usable[:, late])
        for each in (corrected.counts, corrected.variance)
    )
    spread = np.sqrt(np.maximum(variance, 1.0))
    _map(axes[2], raw, sums / spread, "0.5 ns behind the mask, in standard deviations", symmetric=True)


def _draw_dead_time(axes: Any, raw: "RawPoints", constants: "BenchConstants") -> None:
    time_ns = raw.time.centres_s() * 1e9
    before = raw.counts.sum(axis=0, dtype=np.float64)
    after = undo_dead_time(raw, constants)[0].sum(axis=0, dtype=np.float64)
    for panel, values in zip(axes, (before, after), strict=False):
        panel.semilogy(time_ns, np.maximum(values, 0.5))
        panel.set(xlabel="time after sync (ns)", title="counts of all points")
    axes[2].plot(time_ns, after / np.maximum(before, 1))
    axes[2].set(xlabel="time after sync (ns)", title="corrected over recorded")


def _draw_wall(axes: Any, found: "Measurement") -> None:
    raw, fit, corrected = found.raw, found.geometry, found.corrected
    assert raw is not None
    assert fit is not None
    assert corrected is not None
    assert corrected.offsets is not None
    arrival_ns = (raw.time.start_s + corrected.offsets.measured_bins * raw.time.bin_width_s) * 1e9
    _map(axes[0], raw, arrival_ns, "direct arrival (ns)")
    height_mm = fit.height_m * 1e3
    _map(axes[1], raw, arrival_ns - fit.delay_s * 1e9, "travel time (ns)")
    _map(axes[2], raw, height_mm, "height over the fitted plane (mm)", symmetric=True)

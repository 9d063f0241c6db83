"""The report as a page: text, tables and pictures in one HTML file that loads nothing from anywhere."""

import base64
import io
import tempfile
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.chain import calibrate_scan, constants_for
from nlos.cli.terminal import terminal
from nlos.loaded import load_scan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nlos.acquisition.recording.recording import Recording
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import Corrected
    from nlos.loaded import LoadedScan
    from nlos.recon.volume import Reconstruction

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1b1f24; }
h1 { font-size: 1.6rem } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #d0d7de }
table { border-collapse: collapse; width: 100%; font-size: .92rem }
td, th { text-align: left; vertical-align: top; padding: .3rem .8rem .3rem 0; border-bottom: 1px solid #eaeef2 }
td { overflow-wrap: anywhere } td:first-child { white-space: nowrap }
th { font-weight: 600; width: 1%; white-space: nowrap } img { max-width: 100% }
.pictures { display: flex; flex-wrap: wrap; gap: 1rem } .pictures figure { margin: 0; flex: 1 1 22rem }
figure { margin: 0 } figcaption { font-size: .9rem; color: #57606a }
pre { background: #f6f8fa; padding: .8rem; overflow: auto }
@media (max-width: 40rem) { th { width: 40%; white-space: normal } }
summary { cursor: pointer; margin: .6rem 0 }
iframe { width: 100%; height: 32rem; border: 1px solid #d0d7de }
"""

_FOUND = {
    "points_without_direct_peak": "Points without a direct peak",
    "points_off_the_wall_fit": "Points off the fit of the wall",
    "offset_rms_ps": "Time offsets about that fit, RMS (ps)",
    "offset_rms_mm": "The same as a distance (mm)",
    "scanner_position_m": "Scanner, from the wall's centre: x, y, z (m)",
    "electronic_delay_ns": "Delay of cables and electronics (ns)",
    "response_fwhm_ps": "Impulse response, FWHM (ps)",
    "direct_masked_ns": "Direct light masked for (ns)",
    "direct_tail_ps": "Its tail decays in (ps)",
    "background_per_bin": "Background (counts per bin)",
}
"""What a calibration reports -> how the page calls it."""


def write_report(run: Path, target: Path, methods: Sequence[str]) -> None:
    """Writes the report on `run` to `target`: of a scan that has no picture, why. Raises what reading raises, and
    `InvalidSettings` for a method that does not exist, before anything is computed."""
    from nlos.acquisition.recording.checked import open_checked
    from nlos.calibration.errors import CalibrationError
    from nlos.recon.errors import ReconError
    from nlos.recon.methods import find
    from nlos.recon.reconstruct import reconstruct

    knows_falloff = {method: "falloff" in find(method).Settings.model_fields for method in methods}
    with open_checked(run) as recording:
        parts = [_about(recording), _scan(recording)]
        rest = _settings(recording) + _events(recording)
    scan = load_scan(run)
    try:
        constants = constants_for(scan, None)
        transient, calibration = _calibrated(scan, constants)
        parts.append(calibration)
        for method in methods:
            terminal.log(f"{run}: {method}")
            settings: dict[str, object] = {}
            if scan.falloff is not None and knows_falloff[method]:
                settings["falloff"] = scan.falloff
            parts.append(_pictures(reconstruct(transient, method, settings)))
    except (CalibrationError, ReconError) as error:
        terminal.log(f"{run}: no picture: {error}", -1)
        parts.append(f"<h2>No picture</h2><p>{escape(str(error))}</p>")
    parts.append(rest)
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width"><title>{escape(run.name)}</title><style>{_STYLE}</style></head><body>'
        f"<h1>{escape(run.name)}</h1>{''.join(parts)}</body></html>"
    )
    partial = target.with_name(f".{target.name}.part")
    partial.write_text(page, encoding="utf-8")
    partial.replace(target)


def _about(recording: "Recording") -> str:
    plan, header = recording.plan, recording.header
    records = recording.intact_records()
    live_s = float(records["live_time_s"].sum())
    rows = {
        "Started": header.started_utc or "not stored",
        "Status": f"{recording.status.name.lower()}, {len(records)} of {len(plan)} points",
        "Wall": f"{plan.wall.width_m:g} x {plan.wall.height_m:g} m, grid of {plan.wall.rows} x {plan.wall.cols}",
        "Time axis": f"{plan.axis.bins} bins of {plan.axis.bin_width_s * 1e12:g} ps",
        "Light": f"{live_s:.2f} s of live time, {int(records['total_count'].sum()):,} photons",
        **{
            role.capitalize(): f"{who.vendor} {who.product}, serial {who.serial or 'not told'}, "
            f"firmware {who.firmware or 'not told'}"
            for role, who in header.devices.items()
        },
        "Software": ", ".join(f"{name} {version}" for name, version in header.software.items()),
        "Code": header.git_hash or "not from a checkout",
    }
    said = [*header.warnings, *filter(None, [recording.condition().warning])]
    warnings = "".join(f"<p><strong>Warning:</strong> {escape(text)}</p>" for text in said)
    return _table(rows) + warnings


def _settings(recording: "Recording") -> str:
    header = recording.header
    texts = [("The scan file", header.scan_text), ("The bench file", header.bench_text)]
    if not any(text for _, text in texts):
        return ""
    return "<h2>Settings</h2>" + "".join(_folded(name, text, " open") for name, text in texts if text)


def _folded(name: str, text: str, how: str = "") -> str:
    return f"<details{how}><summary>{name}</summary><pre>{escape(text)}</pre></details>"


def _scan(recording: "Recording") -> str:
    from matplotlib.figure import Figure

    plan, records = recording.plan, recording.intact_records()
    numbers = records["number"]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    rate = records["total_count"] / np.maximum(records["live_time_s"], 1e-12)
    dots = left.scatter(plan.positions.x_m[numbers], plan.positions.y_m[numbers], c=rate / 1e3, s=6, marker="s")
    left.set(title="Count rate (kcps)", xlabel="x (m)", ylabel="y (m)", aspect="equal")
    figure.colorbar(dots, ax=left)
    total = np.zeros(plan.axis.bins)
    for _, counts, intact in recording.blocks():
        total += counts[intact].sum(axis=0, dtype=np.float64)
    right.semilogy((plan.axis.offset_s + np.arange(plan.axis.bins) * plan.axis.bin_width_s) * 1e9, total + 0.5)
    right.set(title="All histograms added up", xlabel="time after the laser pulse (ns)", ylabel="counts")
    return f"<h2>Scan</h2>{_picture(figure, 'count rate over the wall, and the sum of all histograms')}"


def _calibrated(scan: "LoadedScan", constants: "BenchConstants | None") -> tuple["Transient", str]:
    """What `reconstruct` would work on, and a section on how it was calibrated."""
    from nlos.calibration.correct import correct

    if scan.rectified:
        text = "<p>The source of this recording was rectified already.</p>"
        return calibrate_scan(scan), f"<h2>Calibration</h2>{text}"
    by = "the scan's own direct light"
    if constants is not None:
        by += f", and constants of the bench measured {constants.measured_utc}"
    if scan.points is not None:
        return calibrate_scan(scan, constants=constants), f"<h2>Calibration</h2><p>By {escape(by)}.</p>"
    corrected = correct(scan.transient, constants, sync_count=scan.sync_count, total_count=scan.total_count)
    return corrected.transient, f"<h2>Calibration</h2><p>By {escape(by)}.</p>{_residuals(corrected)}"


def _residuals(corrected: "Corrected") -> str:
    from matplotlib.figure import Figure

    found = corrected.report()
    rows = {label: _number(found[key]) for key, label in _FOUND.items() if found.get(key) is not None}
    offsets = corrected.points.offsets
    if offsets is None:
        return _table(rows)
    wall, width_ps = corrected.transient.wall, corrected.transient.time.bin_width_s * 1e12
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    shape = (wall.rows, wall.cols)
    _map(figure, left, offsets.offset_bins.reshape(shape) * width_ps, "Time offset (ps)", wall.width_m, wall.height_m)
    if offsets.wall is not None:
        residual_ps = offsets.residual_bins.reshape(shape) * width_ps
        _map(figure, right, residual_ps, "Residual (ps)", wall.width_m, wall.height_m)
    return _table(rows) + _picture(figure, "time offset of every point, and what the wall fit leaves")


def _map(
    figure: "Figure", axes: object, values: npt.NDArray[np.float64], title: str, width_m: float, height_m: float
) -> None:
    extent = (-width_m / 2, width_m / 2, -height_m / 2, height_m / 2)
    picture = axes.imshow(values, extent=extent)  # type: ignore[attr-defined]
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)")  # type: ignore[attr-defined]
    figure.colorbar(picture, ax=axes)  # type: ignore[arg-type]


def _pictures(result: "Reconstruction") -> str:
    from nlos.recon.pictures import albedo_picture, depth_picture
    from nlos.recon.view3d import write_view3d

    figures = []
    with tempfile.TemporaryDirectory(prefix="nlos-report-") as folder:
        for draw, name in ((albedo_picture, "front view"), (depth_picture, "depth")):
            image = Path(folder) / "picture.png"
            draw(result, image)
            figures.append(_embedded(image.read_bytes(), f"{result.method}: {name}"))
        page = Path(folder) / "view.html"
        write_view3d(page, result)
        # In a sandbox: the view's script turns points, and reaches nothing else of the page.
        view = f'<iframe sandbox="allow-scripts" title="3D view" srcdoc="{escape(page.read_text(encoding="utf-8"))}">'
    weights = "" if result.weights_sha256 is None else f"; weights sha256 {result.weights_sha256[:12]}"
    settings = "\n".join(f"{key}: {value}" for key, value in result.settings.items() if value is not None)
    return (
        f"<h2>{escape(result.method)}</h2><p>{result.seconds:.2f} s of computing{weights}</p>"
        f"{_folded('Its settings', settings)}"
        f'<div class="pictures">{"".join(figures)}</div>{view}</iframe>'
    )


def _events(recording: "Recording") -> str:
    lines = "".join(
        f"<tr><td>{event.bench_s:.3f} s</td><th>{escape(event.kind)}</th><td>{escape(event.text)}</td></tr>"
        for event in recording.events()
    )
    return f"<h2>Events</h2><table>{lines}</table>" if lines else "<h2>Events</h2><p>None.</p>"


def _table(rows: dict[str, str]) -> str:
    lines = "".join(f"<tr><th>{escape(key)}</th><td>{escape(value)}</td></tr>" for key, value in rows.items())
    return f"<table>{lines}</table>"


def _number(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(_number(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _picture(figure: "Figure", caption: str) -> str:
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=120)
    return _embedded(image.getvalue(), caption)


def _embedded(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )

"""`nlos info`: what is in a file: a recording, a scan of another program, weights, constants, a result."""

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from nlos.acquisition.importers.isolated import NoScan, read_isolated
from nlos.acquisition.importers.magic import HDF5_MAGIC, is_recording, magic_of
from nlos.acquisition.importers.to_recording import said_by_source
from nlos.acquisition.recording.ended_as_asked import status_word
from nlos.acquisition.recording.frames import frame_table
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.scanning.advice import reasons
from nlos.acquisition.wall import ORIENTATION
from nlos.cli.info_of_products import of_product
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.recording.recording import Recording

TRUTH = ("gt_intensity", "gt_depth", "gt_mask")
NO_CONDITIONS = (*TRUTH, "gt_albedo", "gt_coverage", "exposure_s", "time_offset_bins", "response", "format")


def info(run: Annotated[Path, typer.Argument(metavar="RUN")]) -> None:
    """What is in a recording, in any file that an importer reads, in a scene with its truth, in weights (a file, or a
    name of those that ship), constants and results."""
    found = _found(run)
    width = max(len(key) for key in found) + 2
    for key, value in found.items():
        if key not in ("events", "frame table"):
            terminal.result(f"{key:<{width}}{_shown(value)}")
    for event in found.get("events", []):
        terminal.result(f"{event['bench_s']:>10.3f} s  {event['kind']}: {event['text']}")
    terminal.document.update(found)


def _found(run: Path) -> dict[str, Any]:
    if run.suffix == ".safetensors" or _ships(run):
        from nlos.recon.weights.described import summary

        return summary(str(run))
    if is_recording(run):
        with open_checked(run) as recording:
            found = _of_recording(recording)
        return found if _imported_wall_known(found) else found | {"wall": _found_wall(run)}
    if magic_of(run) == HDF5_MAGIC and (product := of_product(run)) is not None:
        return product
    return _of_import(run)


def _imported_wall_known(found: dict[str, Any]) -> bool:
    return found["imported"].get("wall_known", True) is not False


def _found_wall(run: Path) -> str:
    """The wall of a file that does not say it, as `reconstruct` takes it."""
    from nlos.loaded import load_scan

    scan = load_scan(run)
    wall = scan.transient.wall
    size = f"{wall.width_m:.4g} x {wall.height_m:.4g} m, {wall.rows} x {wall.cols}"
    if scan.wall_error_m is None:
        return f"{size}: assumed; neither the file nor its times tell it. `reconstruct` takes --wall-size-m"
    return f"{size}: not stored, found by the direct times to {scan.wall_error_m:.1g} m"


def _ships(run: Path) -> bool:
    """Whether there is no such file, and weights of that name come with the package."""
    from nlos.recon import weights

    folder = Path(weights.__file__).parent
    return not run.exists() and run.name == str(run) and (folder / f"{run}.safetensors").is_file()


def _of_recording(recording: "Recording") -> dict[str, Any]:
    plan, header, records, left_aside = (
        recording.plan, recording.header, recording.intact_records(), recording.left_aside()
    )  # fmt: skip
    live_s = float(records["live_time_s"].sum())
    return {
        "format": "recording",
        "status": status_word(recording) + (", damaged since: `nlos verify` says where" if left_aside else ""),
        "points": f"{len(records)} of {_planned(plan)}" + (f", {left_aside} more skipped" if left_aside else ""),
        "skipped": left_aside,
        "with a full bin": len(recording.condition().full),
        "identity": header.identity,
        "wall": f"{plan.wall.width_m:g} x {plan.wall.height_m:g} m, {plan.wall.rows} x {plan.wall.cols}",
        "orientation": ORIENTATION,
        **_of_frames(recording, records),
        "time axis": f"{plan.axis.bins} bins of {plan.axis.bin_width_s * 1e12:g} ps, "
        f"from {plan.axis.offset_s * 1e9:g} ns",
        "live time": f"{live_s:.3f} s of {plan.dwell_total_s:.3f} s planned"
        if plan.budget is None
        else f"{live_s:.3f} s",
        **_of_batches(recording),
        "photons": int(records["total_count"].sum()),
        "flagged": int((records["flags"] != 0).sum()),
        "started": header.started_utc,
        **header.notes.shown(),
        "devices": {role: f"{who.product} {who.serial} ({who.model})" for role, who in header.devices.items()},
        "constants": _constants_of(header.constants_json),
        "software": dict(header.software),
        "git hash": header.git_hash,
        "warnings": list(header.warnings),
        "imported": {key: value for key, value in _imported(recording).items() if key != "time_offset_bins"},
        "events": [
            {"unix_s": event.unix_s, "bench_s": event.bench_s, "kind": event.kind, "text": event.text}
            for event in recording.events()
        ],
    }


def _planned(plan: "ScanPlan") -> str:
    if plan.until_stopped:
        return f"at most {len(plan)}, until stopped"
    return str(len(plan)) if plan.budget is None else f"at most {plan.most_samples}, {len(plan)} candidates"


def _of_batches(recording: "Recording") -> dict[str, Any]:
    """Of a recording whose points were chosen on the way: in which time, how many for which reason."""
    if recording.plan.budget is None:
        return {}
    why: dict[str, int] = {}
    for each in reasons(((event.kind, event.text) for event in recording.events()), len(recording)):
        word = f"{each.word} at {each.dwell_s * 1e3:g} ms"
        why[word] = why.get(word, 0) + each.count
    return {"budget": f"{recording.plan.budget.total_us / 1e6:g} s", "points by reason": why}


def _constants_of(constants_json: str) -> str:
    """Which measured constants aimed the scan."""
    try:
        used = json.loads(constants_json)
    except ValueError:
        return "cannot be read"
    if not (isinstance(used, dict) and used):
        return "none: aimed by the bench file"
    aimed = "aimed it" if used.get("geometry") else "took part"
    return f"those of {used.get('measured_utc', 'an unknown day')}, of bench {used.get('bench') or 'unknown'}, {aimed}"


def _of_frames(recording: "Recording", records: Any) -> dict[str, Any]:
    """Of a recording of several frames: how many, how fast, and each one's time, laser and light."""
    plan = recording.plan
    if plan.frames == 1:
        return {}
    table = frame_table(plan, records)
    columns = {field.name: getattr(table, field.name) for field in fields(table)}
    rows = [
        {name: None if math.isnan(value) else value for name, value in zip(columns, row, strict=True)}
        for row in zip(*(column.tolist() for column in columns.values()), strict=True)
    ]
    return {"frames": table.said(), "frame table": rows}


def _imported(recording: "Recording") -> dict[str, object]:
    return said_by_source(recording)


def _of_import(run: Path) -> dict[str, Any]:
    try:
        scan = read_isolated(run, describe=True)
    except NoScan as error:
        holds = dict(error.contents)
        if set(TRUTH) <= holds.keys() and (conditions := [name for name in holds if name not in NO_CONDITIONS]):
            return holds | {
                "format": "scene with its truth", "conditions": ", ".join(conditions),
                "use": "nlos evaluate --data, or `data: {files: ...}` of a training file",
            }  # fmt: skip
        return {**holds, "not a scan": str(error)}
    held = scan.held
    wall, time = held.wall, held.time
    points = "" if scan.points is None else f"{len(scan.points.x_m)} points at free positions; grid "
    return {
        "format": scan.source_format,
        "wall": f"{wall.width_m:g} x {wall.height_m:g} m, {points}{wall.rows} x {wall.cols}"
        if scan.wall_known
        else _found_wall(run),
        "orientation": ORIENTATION,
        "time axis": f"{time.bins} bins of {time.bin_width_s * 1e12:g} ps",
        "photons": float(held.counts.sum(dtype="float64")),
        "rectified": scan.rectified,
        "direct cut": scan.direct_cut_bins,
        "falloff": scan.falloff,
        "notes": list(scan.notes),
    }


def _shown(value: object) -> str:
    """A value for people: a block as `key value; key value`, without what is empty."""
    if isinstance(value, dict):
        said = ((key, one) for key, one in value.items() if one not in (None, "", [], (), {}))
        return "; ".join(
            f"{key} ({_shown(one)})" if isinstance(one, dict) else f"{key} {_shown(one)}" for key, one in said
        )
    if isinstance(value, float):
        return f"{value:.6g}"
    return value if isinstance(value, str) else json.dumps(value, default=str)

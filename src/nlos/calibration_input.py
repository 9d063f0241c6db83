"""What `nlos calibrate` starts from: runs with their devices and aim, and tables of spots."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.planning.aim import Aim
    from nlos.calibration.geometry import ScannerGeometry
    from nlos.calibration.geometry_fit import Spots
    from nlos.calibration.raw_points import RawPoints


@dataclass(frozen=True)
class RunInput:
    """One run, as it is calibrated from."""

    raw: "RawPoints"
    devices: Mapping[str, str]
    """Role -> model and serial number."""
    aim: "Aim | ScannerGeometry | None"
    """What the scan was aimed by."""
    meant_dark: bool
    """Whether its bench was forbidden to open the shutter."""


def load_run(run: Path, wall_size_m: float | None = None) -> RunInput:
    """Reads a recording or an importer's format. Raises `InvalidData` for one that is rectified already.

    `wall_size_m`: the wall's side, where the file does not store it; without, the direct times are asked.
    """
    from nlos.acquisition.importers.isolated import read_isolated
    from nlos.acquisition.importers.magic import is_recording
    from nlos.acquisition.importers.to_recording import said_by_source
    from nlos.acquisition.recording.checked import open_checked
    from nlos.calibration.errors import InvalidData
    from nlos.calibration.raw_points import from_samples, from_transient

    if not is_recording(run):
        scan = read_isolated(run)
        _refuse_rectified(run, scan.rectified)
        raw = from_transient(scan.transient)
        if not scan.wall_known:
            raw = _on_wall(run, raw, scan.transient.wall.width_m, wall_size_m)
        return RunInput(raw, {}, None, False)
    with open_checked(run) as recording:
        said = said_by_source(recording)
        _refuse_rectified(run, bool(said.get("rectified", False)))
        try:
            raw = from_samples(recording.samples())
        except InvalidData as error:
            raise type(error)(f"{run}: {error}") from error
        names = {role: f"{device.model} {device.serial}".strip() for role, device in recording.header.devices.items()}
        aim = _aimed_by(recording.header.constants_json, recording.header.bench_json)
        dry_run = bool(json.loads(recording.header.bench_json).get("safety", {}).get("dry_run", False))
        if not said.get("wall_known", True):
            raw = _on_wall(run, raw, recording.plan.wall.width_m, wall_size_m)
    return RunInput(raw, names, aim, dry_run)


def _refuse_rectified(run: Path, rectified: bool) -> None:
    from nlos.calibration.errors import InvalidData

    if rectified:
        raise InvalidData(f"{run}: is rectified already (time 0 is the direct arrival); there is nothing to measure.")


def _on_wall(run: Path, raw: "RawPoints", side_m: float, wall_size_m: float | None) -> "RawPoints":
    """The points of a file without a wall size, `side_m` having stood in for it: on the wall that was named, else on
    the one that the direct times tell."""
    from nlos.calibration.background import is_flat
    from nlos.calibration.wall_size import wall_scale

    if wall_size_m is not None:
        return raw.scaled(wall_size_m / side_m)
    raw.check()
    scale = None if is_flat(raw.counts) else wall_scale(raw)
    if scale is None:
        terminal.log(f"warning: {run}: the wall's size is not stored; {side_m:g} m stands in. Say --wall-size-m.")
        return raw
    found_m, error_m = scale.value * side_m, scale.error * side_m
    terminal.result(
        f"the wall's size is not stored: by the direct times it is {found_m:.3f} +- {error_m:.3f} m wide",
        wall_size_m=found_m, wall_size_error_m=error_m,
    )  # fmt: skip
    return raw.scaled(scale.value)


def refuse_unmeant_darkness(runs: list[Path], loaded: list[RunInput]) -> None:
    """Raises `ShutterClosed` for a scan without light: a dark rate is no answer to a shutter that did not open."""
    from nlos.calibration.errors import ShutterClosed

    for run, one in zip(runs, loaded, strict=True):
        if not one.meant_dark:
            each = float(one.raw.counts.sum(axis=1, dtype=float).mean())
            raise ShutterClosed(
                f"{run}: no laser light reached the detector: all {len(one.raw.counts)} points, from {one.raw.name(0)} "
                f"on, hold {each:.2f} counts on average, evenly over time. Was the shutter closed? If this run was "
                "meant to be dark, say --dark, or give it together with a scan."
            )


def read_spots(path: Path) -> "Spots":
    """Spots from a table with a header line. Raises `InvalidData` naming file, line and column."""
    import csv

    import numpy as np

    from nlos.calibration.errors import InvalidData
    from nlos.calibration.geometry_fit import Spots

    columns = ("x_deg", "y_deg", "x_m", "y_m")
    with path.open(newline="", encoding="utf-8-sig") as file:
        table = csv.DictReader(file, skipinitialspace=True)
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        if missing:
            raise InvalidData(f"{path}: has no column {', '.join(missing)}; expected {', '.join(columns)}")
        rows = []
        for row in table:
            try:
                rows.append([float(row[name]) for name in columns])
            except (TypeError, ValueError):
                raise InvalidData(f"{path}:{table.line_num}: {dict(row)} does not hold four numbers") from None
    x_deg, y_deg, x_m, y_m = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    if not np.isfinite(rows).all():
        raise InvalidData(f"{path}: holds numbers that are not finite")
    return Spots(np.deg2rad(x_deg), np.deg2rad(y_deg), x_m, y_m)


def _aimed_by(constants_json: str, bench_json: str) -> "Aim | ScannerGeometry | None":
    """The earlier constants' geometry where they took part in the scan, else the bench file's; None without either."""
    from nlos.acquisition.planning.aim import Aim
    from nlos.calibration.geometry import ScannerGeometry

    fitted = json.loads(constants_json).get("geometry")
    if fitted:
        return ScannerGeometry(**fitted)
    drawn = json.loads(bench_json).get("geometry")
    return Aim(drawn["wall_distance_m"], drawn.get("mirror_separation_m", 0.0)) if drawn else None


def common_devices(runs: list[Path], each: list[Mapping[str, str]]) -> Mapping[str, str]:
    """The devices that all runs name. Raises `ForeignConstants` where two runs come from different ones."""
    from nlos.calibration.errors import ForeignConstants

    common: dict[str, str] = {}
    for run, names in zip(runs, each, strict=True):
        for role, name in names.items():
            if common.setdefault(role, name) != name:
                raise ForeignConstants(
                    f"{run}: its {role} is {name}, the other runs' is {common[role]}. Calibrate one bench at a time."
                )
    return common

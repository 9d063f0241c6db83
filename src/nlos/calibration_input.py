"""What `nlos calibrate` starts from: runs with their devices and aim, and tables of spots."""

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.isolated import read_isolated
from nlos.acquisition.importers.magic import check_is_file, is_recording, read_bytes
from nlos.acquisition.importers.to_recording import said_by_source
from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.calibration.bench_facts import Facts, changes, facts_of
from nlos.calibration.errors import ForeignConstants, InvalidData, ShutterClosed
from nlos.calibration.geometry_fit import RULER_M, Spots
from nlos.calibration.raw_points import RawPoints, from_samples, from_transient
from nlos.calibration.wall_size import found_side
from nlos.cli.terminal import terminal
from nlos.drawn_bench import aimed_by, scanner_of

if TYPE_CHECKING:
    from nlos.calibration.geometry import ScannerGeometry


LARGEST_TABLE_BYTES = 8 << 20


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
    bench_json: str = "{}"
    """Its bench file, where the run says."""
    identity: str = ""
    """What no other recording is called, but copies of it are; empty where there is none."""


def refuse_twice(runs: list[Path], names: Iterable[str]) -> None:
    """Raises `InvalidData` for a run that is given twice, by its name or as a copy: its photons would count twice, and
    every error come out too small. `names` are what runs of one content have in common, empty where nobody knows."""
    known: dict[str, Path] = {}
    for run, name in zip(runs, names, strict=True):
        if name in known:
            raise InvalidData(f"{run}: is the same run as {known[name]}, and photons count once. Leave one out.")
        if name:
            known[name] = run


def load_run(run: Path, given: Given = NOTHING) -> RunInput:
    """Reads a recording or an importer's format. Raises `InvalidData` for one that is rectified already, unless it is
    `given` that it is not.

    The wall's width is as given where the file does not store it; without, the direct times are asked.
    """
    wall_size_m = None if given.wall_m is None else given.wall_m[0]
    if not is_recording(run):
        scan = read_isolated(run, Given(rectified=given.rectified, detector=given.detector))
        _refuse_rectified(run, scan.rectified)
        free = scan.points
        if free is None:
            raw = from_transient(scan.transient)
        else:
            nothing = np.zeros_like(free.exposure_s)
            raw = RawPoints(free.counts, free.x_m, free.y_m, free.exposure_s, nothing, nothing, free.time)
        if not scan.wall_known:
            raw = _on_wall(run, raw, scan.held.wall.width_m, wall_size_m)
        return RunInput(raw, {}, None, False)
    if given.detector is not None:
        raise InvalidData(f"{run}: is a recording: it knows its detector; leave --detector out")
    with open_checked(run) as recording:
        said = said_by_source(recording)
        _refuse_rectified(run, given.rectified is None and bool(said.get("rectified", False)))
        try:
            raw = from_samples(recording.samples(), visits=True)
            recording.left_aside()
        except InvalidData as error:
            raise type(error)(f"{run}: {error}") from error
        names = {role: f"{device.model} {device.serial}".strip() for role, device in recording.header.devices.items()}
        aim = aimed_by(recording.header.constants_json, recording.header.bench_json)
        safety = json.loads(recording.header.bench_json).get("safety")
        dry_run = isinstance(safety, dict) and bool(safety.get("dry_run", False))
        if not said.get("wall_known", True):
            raw = _on_wall(run, raw, recording.plan.wall.width_m, wall_size_m)
        raw = replace(raw, scanner_m=scanner_of(aim))
        bench_json, identity = recording.header.bench_json, recording.header.identity
    return RunInput(raw, names, aim, dry_run, bench_json, identity)


def _refuse_rectified(run: Path, rectified: bool) -> None:
    if rectified:
        raise InvalidData(
            f"{run}: is rectified already (time 0 is the direct arrival); there is nothing to measure. If it is raw "
            "and only does not say so: --raw."
        )


def _on_wall(run: Path, raw: "RawPoints", side_m: float, wall_size_m: float | None) -> "RawPoints":
    """The points of a file without a wall size, for which `side_m` was assumed: on the wall that was named, else on
    the one that the direct times tell."""
    if wall_size_m is not None:
        return raw.scaled(wall_size_m / side_m)
    raw.check()
    found = found_side(raw, side_m)
    if found is None:
        terminal.log(f"warning: {run}: the wall's size is not stored; assuming {side_m:g} m. Use --wall-size-m.")
        return raw
    found_m, error_m = found
    terminal.result(
        f"the wall's size is not stored: by the direct times it is {found_m:.3f} +- {error_m:.3f} m wide",
        wall_size_m=found_m, wall_size_error_m=error_m,
    )  # fmt: skip
    return raw.scaled(found_m / side_m)


def refuse_unmeant_darkness(runs: list[Path], loaded: list[RunInput]) -> None:
    """Raises `ShutterClosed` for a scan without light: a dark rate is no answer to a shutter that did not open."""
    for run, one in zip(runs, loaded, strict=True):
        if not one.meant_dark:
            each = float(one.raw.counts.sum(axis=1, dtype=float).mean())
            raise ShutterClosed(
                f"{run}: no laser light reached the detector: all {len(one.raw.counts)} points, from {one.raw.name(0)} "
                f"on, hold {each:.2f} counts on average, evenly over time. Was the shutter closed? If this run was "
                "meant to be dark, use --dark, or give it together with a scan."
            )


def _wrong_spot(row: Mapping[str, Any], columns: Sequence[str]) -> str:
    """What is wrong with a line that does not hold four numbers, and what to do."""
    empty = [name for name in columns if not str(row.get(name) or "").strip()]
    if empty:
        return f"{' and '.join(empty)} empty: write in what the ruler says, or delete the line"
    given = ", ".join(f"{name} {row[name]!r}" for name in columns)
    return f"not four numbers ({given}): angles in degrees, places in metres, with a decimal point"


def read_spots(path: Path, ruler_m: float = RULER_M) -> "Spots":
    """Spots from a table with a header line, each read to within `ruler_m`. Raises `InvalidData` naming file, line and
    column."""
    columns = ("x_deg", "y_deg", "x_m", "y_m")
    check_is_file(path)
    if path.stat().st_size > LARGEST_TABLE_BYTES:
        raise InvalidData(f"{path}: is larger than any table of spots ({LARGEST_TABLE_BYTES >> 20} MiB)")
    rows, lines = [], []
    try:
        with read_bytes(path) as file:
            text = io.StringIO(file.read().decode("utf-8-sig"), newline="")
        table = csv.DictReader(text, skipinitialspace=True)
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        if missing:
            raise InvalidData(f"{path}: has no column {', '.join(missing)}; expected {', '.join(columns)}")
        for row in table:
            try:
                rows.append([float(row[name]) for name in columns])
                lines.append(table.line_num)
            except (TypeError, ValueError):
                raise InvalidData(f"{path}:{table.line_num}: {_wrong_spot(row, columns)}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InvalidData(f"{path}: is not a table of comma-separated values ({error})") from error
    x_deg, y_deg, x_m, y_m = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    if not np.isfinite(rows).all():
        raise InvalidData(f"{path}: holds numbers that are not finite")
    return Spots(np.deg2rad(x_deg), np.deg2rad(y_deg), x_m, y_m, ruler_m, tuple(lines), str(path))


def common_devices(runs: list[Path], each: list[Mapping[str, str]]) -> Mapping[str, str]:
    """The devices that all runs name. Raises `ForeignConstants` where two runs come from different ones."""
    common: dict[str, str] = {}
    for run, names in zip(runs, each, strict=True):
        for role, name in names.items():
            if common.setdefault(role, name) != name:
                raise ForeignConstants(
                    f"{run}: its {role} is {name}, the other runs' is {common[role]}. Calibrate one bench at a time."
                )
    return common


def common_bench(runs: list[Path], each: list[str]) -> "tuple[str, Facts]":
    """The name of the bench that all runs are of, and what constants depend on of it; empty where no run says. Raises
    `ForeignConstants` where the bench was changed between two of them."""
    known = [(run, *facts_of(text)) for run, text in zip(runs, each, strict=True)]
    known = [(run, name, facts) for run, name, facts in known if name]
    if not known:
        return "", {}
    first, name, facts = known[0]
    for run, other, its in known[1:]:
        differ = changes(facts, its) if other == name else [f"bench {name} then, {other} now"]
        if differ:
            raise ForeignConstants(
                f"{run}: its bench is not as it was in {first}: {'; '.join(differ)}. Calibrate one bench at a time."
            )
    return name, facts

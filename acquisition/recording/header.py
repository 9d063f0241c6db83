"""The part of a scan file that never changes, written once and read with every size checked: header and plan."""

import hashlib
import json
from dataclasses import astuple
from typing import Any

import h5py
import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.budget import Budget
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.validation import check_geometry, check_plan, chunks_fit, json_object, json_texts
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import HistogramAxis, StopAtCounts

FORMAT, VERSION = "nlos-scan", 1
MAX_TEXT_BYTES = 1 << 22
LATER = ("identity", "run_json")
"""Texts that recordings of earlier versions do not have."""
COLUMNS = {"row": "<i4", "col": "<i4", "x_m": "<f8", "y_m": "<f8", "dwell_s": "<f8", "pass": "<i4"}
STATES = (
    "width_m", "height_m", "rows", "cols", "bins", "bin_width_s", "offset_s", "stop", "revisit_below", "within_px",
    "budget", "until_stopped", "digest",
)  # fmt: skip
"""Attributes of `/plan`; programs that copy recordings add their own."""


def write_header(file: h5py.File, header: Header) -> None:
    """Texts as fixed-length UTF-8, so that a reader knows each size before it reads."""
    group = file.create_group("header")
    for name, text in header.texts().items():
        raw = text.encode("utf-8")
        if len(raw) > MAX_TEXT_BYTES:
            raise InvalidData(f"{name} is {len(raw)} bytes long; a recording keeps {MAX_TEXT_BYTES} at most")
        dtype = h5py.string_dtype("utf-8", max(len(raw), 1))
        group.create_dataset(name, data=np.array(raw, dtype=dtype), dtype=dtype)


def read_header(file: h5py.File) -> Header:
    """The header. Raises `InvalidData` naming the place, `ValueError` or `KeyError` where a text is not what it was."""
    if _text(file.attrs.get("format")) != FORMAT:
        raise InvalidData(f"{file.filename}: not a recording (its attribute format is {file.attrs.get('format')!r})")
    if file.attrs.get("version") != VERSION:
        raise InvalidData(f"{file.filename}: recording version {file.attrs.get('version')!r}; {VERSION} is read")
    texts = {}
    for name in Header().texts():
        if name in LATER and not _has(file, name):
            continue
        item = plain_dataset(file, f"header/{name}", (), None)
        if item.dtype.kind != "S" or item.dtype.itemsize > MAX_TEXT_BYTES:
            raise InvalidData(f"{file.filename}: header/{name}: is not a text of at most {MAX_TEXT_BYTES} bytes")
        texts[name] = bytes(item[()]).decode("utf-8")
    if "identity" not in texts:
        # Recordings had none once; what they say of themselves, the moment of their start included, has to do.
        texts["identity"] = hashlib.sha256(json.dumps(texts, sort_keys=True).encode()).hexdigest()[:32]
    for name in ("scan_json", "bench_json", "constants_json"):
        json_object(f"{file.filename}: header/{name}", texts[name])
    devices = json_object(f"{file.filename}: header/devices", texts["devices"])
    named = {"software": json_object(f"{file.filename}: header/software", texts["software"]), **devices}
    for name, texts_of in named.items():
        if not isinstance(texts_of, dict) or not all(isinstance(text, str) for text in texts_of.values()):
            raise InvalidData(f"{file.filename}: header: {name!r}: must hold texts by name")
    json_texts(f"{file.filename}: header/warnings", texts["warnings"])
    return Header.from_texts(texts)


def _text(stored: object) -> object:
    """A text attribute as it was written: programs that copy recordings may store it as bytes of a fixed length."""
    return stored.decode("utf-8", "replace") if isinstance(stored, bytes) else stored


def has_identity(file: h5py.File) -> bool:
    """Whether the file holds a random identity of its own: those of the first versions do not."""
    return _has(file, "identity")


def _has(file: h5py.File, name: str) -> bool:
    if not isinstance(file.get("header", getlink=True), h5py.HardLink) or not isinstance(file["header"], h5py.Group):
        raise InvalidData(f"{file.filename}: header: is missing or a link to elsewhere")
    return name in file["header"].keys()  # noqa: SIM118 - `in` a group follows links


def write_plan(file: h5py.File, plan: ScanPlan) -> None:
    """Scalars as attributes of `/plan`, points as its datasets."""
    kept = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    kept.set_attr_phase_change(32, 16)  # in the group's own header: h5copy of HDF5 1.10 crashes on texts beyond it
    group = h5py.Group(h5py.h5g.create(file.id, b"plan", gcpl=kept))
    stop = plan.stop
    group.attrs["width_m"], group.attrs["height_m"] = plan.wall.width_m, plan.wall.height_m
    group.attrs["rows"], group.attrs["cols"] = plan.wall.rows, plan.wall.cols
    group.attrs["bins"], group.attrs["bin_width_s"] = plan.axis.bins, plan.axis.bin_width_s
    group.attrs["offset_s"] = plan.axis.offset_s
    group.attrs["stop"] = [stop.counts, stop.first_bin, stop.end_bin] if stop else [0, 0, 0]
    group.attrs["revisit_below"] = plan.revisit_below or 0
    if plan.within_px is not None:
        group.attrs["within_px"] = plan.within_px
    if plan.budget is not None:
        group.attrs["budget"] = list(astuple(plan.budget))
    if plan.until_stopped:
        group.attrs["until_stopped"] = 1
    group.attrs["digest"] = plan.digest()
    for name, column in plan.columns().items():
        group.create_dataset(name, data=column, dtype=COLUMNS[name])


def read_plan(file: h5py.File, size_bytes: int) -> ScanPlan:
    """The plan, its arrays checked against the file's size before they are read, and against its digest afterwards."""
    shape = plain_dataset(file, "plan/row", None, np.dtype(COLUMNS["row"])).shape
    group = file["plan"]
    states = {
        name: np.asarray(group.attrs[name])
        for name in STATES
        if name in group.attrs and group.attrs.get_id(name).get_storage_size() < 1024
    }
    if len(shape) != 1:
        raise InvalidData(f"{file.filename}: plan/row: has shape {shape}")
    wall = WallGrid(float(states["width_m"]), float(states["height_m"]), int(states["rows"]), int(states["cols"]))
    axis = HistogramAxis(int(states["bins"]), float(states["bin_width_s"]), float(states["offset_s"]))
    check_geometry(file.filename, wall, axis, shape[0])
    columns = {}
    for name, dtype in COLUMNS.items():
        item = plain_dataset(file, f"plan/{name}", shape, np.dtype(dtype))
        place = item.id.get_offset()
        if item.chunks:
            raise _not_as_written(file, f"plan/{name}")
        if place is None or place + item.nbytes > size_bytes:
            raise InvalidData(f"{file.filename}: plan/{name}: states {shape[0]} points but does not hold them")
        columns[name] = item[:]
    counts, first_bin, end_bin = (int(value) for value in states["stop"])
    plan = ScanPlan(
        wall=wall,
        axis=axis,
        positions=Positions(columns["row"], columns["col"], columns["x_m"], columns["y_m"]),
        dwell_s=columns["dwell_s"],
        pass_=columns["pass"],
        stop=StopAtCounts(counts, first_bin, end_bin) if counts else None,
        revisit_below=int(states["revisit_below"]) or None,
        within_px=float(states["within_px"]) if "within_px" in states else None,
        budget=_budget(states["budget"].tolist()) if "budget" in states else None,
        until_stopped=bool(states.get("until_stopped", 0)),
    )
    if plan.digest() != _text(states["digest"][()]):
        raise InvalidData(f"{file.filename}: the plan does not match its own digest; the file is damaged")
    check_plan(file.filename, plan)
    return plan


def _budget(stored: list[int]) -> Budget:
    total_us, step_us, batch, after_first = stored
    return Budget(total_us, step_us, batch, bool(after_first))


def _not_as_written(file: h5py.File, name: str) -> InvalidData:
    return InvalidData(
        f"{file.filename}: {name}: is compressed or in chunks, as another program stores it. Of that, "
        f"`h5repack -f NONE -l CONTI {file.filename} NEW.h5` (HDF5's own tools) makes a recording that is read."
    )


def plain_dataset(
    file: h5py.File, name: str, shape: tuple[int, ...] | None, dtype: np.dtype[Any] | None
) -> h5py.Dataset:
    """The dataset at `name` (`group/leaf` or `leaf`): in this file, unfiltered, of this shape and type, else
    `InvalidData`. Links are looked at, never followed."""
    place = f"{file.filename}: {name}"
    parent = file
    *groups, leaf = name.split("/")
    for word in (*groups, leaf):
        if not isinstance(parent, h5py.Group) or not isinstance(parent.get(word, getlink=True), h5py.HardLink):
            raise InvalidData(f"{place}: is missing or a link to elsewhere")
        parent = parent[word]
    item = parent
    if isinstance(item, h5py.Dataset) and (item.id.get_create_plist().get_nfilters() or not chunks_fit(item)):
        raise _not_as_written(file, name)
    if not isinstance(item, h5py.Dataset) or item.is_virtual or item.external:
        raise InvalidData(f"{place}: is not a plain dataset of this file")
    if (shape is not None and item.shape != shape) or (dtype is not None and item.dtype != dtype):
        raise InvalidData(f"{place}: holds {item.dtype} {item.shape}, expected {dtype} {shape}")
    return item

"""Files that somebody made, under checksums that fit: every verb ends with a reason, none with a bug."""

import contextlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.header import read_plan
from nlos.acquisition.recording.recording import sample_crc

SOAK = bool(os.environ.get("NLOS_SOAK"))
DEEP = '{"a":' * 10_000 + "1" + "}" * 10_000
OTHER_JSON = ("[]", "3", '"text"', "null", "{", DEEP, '{"geometry": 3}', '{"geometry": {"x": 1}}', '{"imported": [1]}',
              '{"imported": {"time_offset_bins": [[1], [2, 3]], "direct_cut_bins": 1e9}}', '{"safety": 1}')  # fmt: skip


def text(file: h5py.File, name: str, value: str) -> None:
    del file[f"header/{name}"]
    raw = value.encode()
    file.create_dataset(f"header/{name}", data=np.array(raw, dtype=h5py.string_dtype("utf-8", len(raw))))


def plan(file: h5py.File, **attributes: object) -> None:
    """Plan attributes changed, and the digest made again where such a plan has one."""
    for name, value in attributes.items():
        file["plan"].attrs[name] = value
    redigest(file)


def redigest(file: h5py.File) -> None:
    """States the digest that the plan has, as whoever makes such a file would; a plan that is none keeps its own."""
    found: list[str] = []
    original = ScanPlan.digest

    def kept(self: ScanPlan) -> str:
        found.append(original(self))
        return found[-1]

    ScanPlan.digest = kept  # type: ignore[method-assign]
    try:
        with contextlib.suppress(ValueError, TypeError):
            read_plan(file)
    finally:
        ScanPlan.digest = original  # type: ignore[method-assign]
    if found:
        file["plan"].attrs["digest"] = found[-1]


def column(file: h5py.File, name: str, value: float) -> None:
    file[f"plan/{name}"][0] = value
    redigest(file)


def record(file: h5py.File, **fields: float) -> None:
    """The first record changed, its CRC made again."""
    row = file["samples/records"][0]
    for name, value in fields.items():
        row[name] = value
    row["crc"] = sample_crc(row.tobytes(), file["samples/counts"][0])
    file["samples/records"][0] = row


def status(file: h5py.File, state: int, acknowledged: int = 0) -> None:
    file["status"][0] = (state, acknowledged, 0.0)


def replaced(file: h5py.File, name: str, **options: object) -> None:
    del file[name]
    if options.get("link"):
        file[name] = h5py.ExternalLink("good.h5", "/plan/row")
    elif options.get("group"):
        file.create_group(name)
    else:
        file.create_dataset(name, **options)


Craft = Callable[[h5py.File], None]
RECORDINGS: dict[str, Craft] = {
    **{f"{name} {value[:24]}": (lambda f, n=name, v=value: text(f, n, v))
       for name in ("scan_json", "bench_json", "constants_json", "devices", "software", "warnings")
       for value in OTHER_JSON},
    **{f"wall {value}": (lambda f, v=value: plan(f, width_m=v)) for value in (np.nan, np.inf, 0.0, -1.0, 1e9)},
    **{f"rows {value}": (lambda f, v=value: plan(f, rows=v)) for value in (0, -1, 10**6, 2**40)},
    **{f"bins {value}": (lambda f, v=value: plan(f, bins=v)) for value in (0, -1, 10**6)},
    **{f"bin width {value}": (lambda f, v=value: plan(f, bin_width_s=v)) for value in (0.0, -1e-12, np.nan, 1e300)},
    **{f"offset {value}": (lambda f, v=value: plan(f, offset_s=v)) for value in (-1e-9, np.nan, 1e9)},
    **{f"stop {value}": (lambda f, v=value: plan(f, stop=v)) for value in ([5, 9, 3], [-1, 0, 1], [5, 0, 10**6])},
    **{f"{name} {value}": (lambda f, n=name, v=value: column(f, n, v)) for name, value in (
        ("row", 99), ("col", -7), ("x_m", np.nan), ("y_m", 1e300), ("dwell_s", 1e300), ("dwell_s", 0),
        ("pass", -1), ("pass", 9))},
    **{f"{name} {value}": (lambda f, n=name, v=value: record(f, **{n: v})) for name, value in (
        ("live_time_s", 0.0), ("live_time_s", np.nan), ("live_time_s", -1.0), ("taken_s", np.inf),
        ("number", 4_000_000),
        ("flags", 0xFFFF), ("sync_count", 2**63), ("total_count", 2**63), ("gate_opened_s", np.nan))},
    **{f"status {state}": (lambda f, s=state: status(f, s)) for state in (0, 9, 255)},
    "acknowledged beyond": lambda f: status(f, 2, 10**12),
    "counts growable": lambda f: replaced(f, "samples/counts", shape=(30, 256), dtype="<u4", maxshape=(None, 256)),
    "records a group": lambda f: replaced(f, "samples/records", group=True),
    "counts elsewhere": lambda f: replaced(f, "samples/counts", link=True),
    "events of another type": lambda f: replaced(f, "events", data=np.zeros(1024)),
    "records of text": lambda f: replaced(f, "samples/records", data=np.array([b"x"] * 30)),
}  # fmt: skip
PICTURES: dict[str, Craft] = {
    **{f"{name} {what}": (lambda f, n=name, o=options: replaced(f, n, **o))
       for name in ("albedo", "depth_m", "volume", "depths_m", "confidence")
       for what, options in (("group", {"group": True}), ("text", {"data": "no"}), ("size", {"data": np.ones((3, 7))}),
                             ("link", {"link": True}), ("nothing", {"data": h5py.Empty("f4")}))},
    **{f"settings {value[:12]}": (lambda f, v=value: f.attrs.__setitem__("settings", v)) for value in ("[]", "{", "3")},
    **{f"wall {value}": (lambda f, v=value: f.attrs.__setitem__("wall_size_m", v)) for value in (
        (np.nan, 1.0), (0.0, 0.0), 3.0, "x", (1.0, 1.0, 1.0))},
    "seconds text": lambda f: f.attrs.__setitem__("seconds", "long"),
}  # fmt: skip
CONSTANTS: dict[str, Craft] = {
    **{f"about {value[:12]}": (lambda f, v=value: f.attrs.__setitem__("about", v)) for value in (
        "[]", "{}", "{", DEEP, '{"devices": [], "measured_utc": 1, "sources": 3}')},
    "arrivals elsewhere": lambda f: replaced(f, "arrivals/x_m", link=True),
    "arrivals a dataset": lambda f: replaced(f, "arrivals", data=np.ones(3)),
    "delay not finite": lambda f: replaced(f, "arrivals/delay_s", data=np.nan),
    "delay an array": lambda f: replaced(f, "arrivals/delay_s", data=np.ones(3)),
    "bin width text": lambda f: f.attrs.__setitem__("bin_width_s", "x"),
}  # fmt: skip
PLAINS: dict[str, Craft] = {
    **{f"{name} {value}": (lambda f, n=name, v=value: f.attrs.__setitem__(n, v)) for name, value in (
        ("bin_width_s", 0.0), ("bin_width_s", np.nan), ("bin_width_s", "x"), ("wall_size_m", np.nan),
        ("wall_size_m", -1.0),
        ("wall_size_m", 1e9), ("direct_cut_bins", -3), ("direct_cut_bins", 10**9), ("rectified", np.nan),
        ("rectified", "x"))},
    "counts elsewhere": lambda f: replaced(f, "histograms", link=True),
    "counts a group": lambda f: replaced(f, "histograms", group=True),
    "counts text": lambda f: replaced(f, "histograms", data="no"),
    "counts not numbers": lambda f: replaced(f, "histograms", data=np.full((3, 4, 8), np.nan)),
    "counts claimed": lambda f: replaced(f, "histograms", shape=(4096, 4096, 4096), dtype="u1", chunks=(64, 64, 64)),
    "offsets of another grid": lambda f: replaced(f, "time_offset_bins", data=np.ones((2, 2))),
    "time first": lambda f: replaced(f, "histograms", data=np.ones((512, 8, 8), "u2")),
}  # fmt: skip
CASES = [(kind, name, craft) for kind, crafts in (("recording", RECORDINGS), ("picture", PICTURES),
                                                  ("constants", CONSTANTS), ("plain", PLAINS))
         for name, craft in crafts.items()]  # fmt: skip


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kind", ["recording", "picture", "constants", "plain"])
def test_what_somebody_made_ends_with_a_reason(kinds, verbs, commands, tmp_path: Path, kind: str) -> None:
    whole, bad = kinds[kind].read_bytes(), []
    for index, (_, name, craft) in enumerate(case for case in CASES if case[0] == kind):
        chosen = verbs(kind) if SOAK else [verbs(kind)[index // 6 % len(verbs(kind))]]
        if not SOAK and index % 6:
            continue
        made = tmp_path / f"made{index}.h5"
        made.write_bytes(whole)
        with h5py.File(made, "r+") as file:
            craft(file)
        for words in chosen:
            outcome = commands.run([*words, made.name])
            if outcome.is_a_bug:
                bad.append((name, json.dumps(outcome.words), outcome.text[-600:]))
    assert bad == []

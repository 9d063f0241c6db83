"""Foreign files that somebody made: NPZ, MAT, y-tal and PTU with parts that are not as they should be."""

import json
import os
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import loadmat, savemat

SOAK = bool(os.environ.get("NLOS_SOAK"))
ARRAYS: dict[str, Any] = {
    "of objects": np.array([{"a": 1}, None], dtype=object),
    "of text": np.array(["a", "bc"]),
    "of nothing": np.zeros(0),
    "of five dimensions": np.ones((2, 2, 2, 2, 2)),
    "not numbers": np.full((6, 5, 256), np.nan),
    "complex": np.ones((6, 5)) * 1j,
    "negative": np.full((6, 5, 256), -1.0),
    "one number": np.float64(3.0),
    "of dates": np.array(["2020-01-01"], "M8[D]"),
    "infinite": np.full((6, 5, 256), np.inf),
    "of another size": np.ones((3, 7, 9)),
}
HEADER_END = b"Header_End".ljust(32, b"\0")
IMAGE = ("ImgHdr_Dimensions", "ImgHdr_PixX", "ImgHdr_PixY", "ImgHdr_LineStart", "ImgHdr_LineStop", "ImgHdr_Frame",
         "ImgHdr_Ident", "ImgHdr_BiDirect", "ImgHdr_SinCorrection", "ImgHdr_MaxFrames")  # fmt: skip
INTEGERS = (0, -1, 1, 2**31, 2**62)
REALS = (0.0, -1.0, float("nan"), 1e300, 1e-300)
_INT, _FLOAT = 0x10000008, 0x20000008


def tags(raw: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Where each 48-byte tag of a PTU's header begins, its name and its type (PicoQuant's Unified TTTR format)."""
    at = 16
    while raw[at : at + 32] != HEADER_END:
        kind, value = struct.unpack_from("<Iq", raw, at + 36)
        yield at, raw[at : at + 32].rstrip(b"\0"), kind
        at += 48 + (value if kind in (0x2001FFFF, 0x4001FFFF, 0x4002FFFF, 0xFFFFFFFF) else 0)


def ptus(raw: bytes) -> Iterator[tuple[str, bytes]]:
    """Each number of the header at each extreme; then the tags of an image scanned before 2014, in every state."""
    for at, name, kind in tags(raw):
        values = [struct.pack("<q", v) for v in INTEGERS] if kind == _INT else [struct.pack("<d", v) for v in REALS]
        for value in values if kind in (_INT, _FLOAT) else []:
            yield f"{name.decode()} {value.hex()}", raw[: at + 40] + value + raw[at + 48 :]
    end = raw.index(HEADER_END)
    for name in IMAGE:
        for value in INTEGERS:
            rest = [(other, 1 if other != "ImgHdr_Dimensions" else 3) for other in IMAGE if other != name]
            made = b"".join(
                each.encode().ljust(32, b"\0") + struct.pack("<iIq", -1, _INT, number)
                for each, number in [*rest, (name, value)]
            )
            yield f"image with {name} {value}", raw[:end] + made + raw[end:]
    for length in (16, 40, end, end + 48, end + 50):
        yield f"cut at {length}", raw[:length]


def npzs(whole: Path, target: Path) -> Iterator[str]:
    """Each array as each of the others; one missing."""
    good = dict(np.load(whole))
    for name in good:
        for what, array in ARRAYS.items():
            np.savez(target, allow_pickle=True, **(good | {name: array}))
            yield f"{name} {what}"
        np.savez(target, **{key: value for key, value in good.items() if key != name})
        yield f"without {name}"


def mats(whole: Path, target: Path) -> Iterator[str]:
    good = {key: value for key, value in loadmat(whole).items() if not key.startswith("__")}
    kinds = {key: value for key, value in ARRAYS.items() if key not in ("of objects", "of dates")}
    kinds |= {"a struct": {"a": np.ones(3), "b": "x"}, "cells": np.array([[1], ["x"]], dtype=object)}
    for name in good:
        for what, array in kinds.items():
            savemat(target, good | {name: array})
            yield f"{name} {what}"
        savemat(target, {key: value for key, value in good.items() if key != name})
        yield f"without {name}"


def ytals(whole: Path, target: Path) -> Iterator[str]:
    with h5py.File(whole) as file:
        names = list(file)
    for name in names:
        for what in ("group", "missing", *ARRAYS):
            if what in ("of objects", "of dates"):
                continue
            target.write_bytes(whole.read_bytes())
            with h5py.File(target, "r+") as file:
                del file[name]
                if what == "group":
                    file.create_group(name)
                elif what != "missing":
                    array = np.asarray(ARRAYS[what])
                    file[name] = array.astype("S4") if array.dtype.kind == "U" else array
            yield f"{name} {what}"


def ptu_files(whole: Path, target: Path) -> Iterator[str]:
    for what, raw in ptus(whole.read_bytes()):
        target.write_bytes(raw)
        yield what


MADE: dict[str, Callable[[Path, Path], Iterator[str]]] = {"npz": npzs, "mat": mats, "ytal": ytals, "ptu": ptu_files}


@pytest.mark.soak
@pytest.mark.parametrize("kind", MADE)
def test_what_somebody_made_in_another_format_ends_with_a_reason_that_names_it(
    kinds, verbs, commands, tmp_path: Path, kind: str
) -> None:
    chosen, bad = verbs(kind), []
    target = tmp_path / f"made{kinds[kind].suffix}"
    every = 1 if SOAK else {"npz": 25, "mat": 25, "ytal": 25, "ptu": 25}[kind]
    for index, what in enumerate(MADE[kind](kinds[kind], target)):
        if index % every:
            continue
        for words in chosen if SOAK else [chosen[index // every % len(chosen)]]:
            outcome = commands.run([*words, target.name])
            if outcome.is_a_bug or (outcome.code == 7 and target.name not in outcome.text):
                bad.append((what, json.dumps(outcome.words), outcome.code, outcome.text[-600:]))
    assert bad == []

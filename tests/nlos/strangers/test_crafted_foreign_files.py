"""Foreign files that somebody made: NPZ, MAT, y-tal, Photon-HDF5, SDT and PicoQuant's with parts that are not as they
should be."""

import json
import os
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from tests.nlos.strangers import crafted_picoquant

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


def parts_of(*roots: str) -> Callable[[Path, Path], Iterator[str]]:
    """Each dataset under `roots` of an HDF5 file as something else, or missing; those at its top without `roots`."""

    def files(whole: Path, target: Path) -> Iterator[str]:
        with h5py.File(whole) as file:
            names = [] if roots else list(file)
            file.visititems(
                lambda name, item: (
                    names.append(name) if roots and name.startswith(roots) and isinstance(item, h5py.Dataset) else None
                )
            )
        yield from parts(whole, target, names)

    return files


def parts(whole: Path, target: Path, names: list[str]) -> Iterator[str]:
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


def made_of(craft: Callable[[bytes], Iterator[tuple[str, bytes]]]) -> Callable[[Path, Path], Iterator[str]]:
    """The same for one that makes bytes of bytes."""

    def files(whole: Path, target: Path) -> Iterator[str]:
        for what, raw in craft(whole.read_bytes()):
            target.write_bytes(raw)
            yield what

    return files


MADE: dict[str, tuple[str, Callable[[Path, Path], Iterator[str]]]] = {
    "npz": ("npz", npzs), "mat": ("mat", mats), "ytal": ("ytal", parts_of()),
    "photons": ("photon_hdf5", parts_of("photon_data", "user/picoquant/tags/Im", "user/picoquant/tags/Meas", "acq")),
    "sdt": ("sdt", made_of(crafted_picoquant.older)),
    "ptu numbers": ("ptu", made_of(crafted_picoquant.numbers)), "ptu types": ("ptu", made_of(crafted_picoquant.types)),
    "ptu lists": ("ptu", made_of(crafted_picoquant.lists)), "ptu records": ("ptu", made_of(crafted_picoquant.records)),
    "ptu t2": ("ptu_t2", made_of(crafted_picoquant.records)),
    **{kind: (kind, made_of(crafted_picoquant.older)) for kind in ("phd", "t3r", "pt3", "ht3")},
}  # fmt: skip
"""What is made -> the kind of file that it is made of, and how."""
WHOLE = ("npz", "mat", "ytal")
"""Every file of these is given to every verb; the many of the others to `import`, and to another verb in turn."""
EVERY = {"photons": 75, "ptu types": 80, "ptu lists": 6, "ptu records": 12, "ptu t2": 30} | dict.fromkeys(
    ("phd", "t3r", "pt3", "ht3", "sdt"), 400
)
"""Of how many files `make test` tries one."""


TOGETHER = [[made] for made in MADE] if SOAK else [list(WHOLE), [made for made in MADE if made not in WHOLE]]
"""What is tried by one process."""


@pytest.mark.soak
@pytest.mark.parametrize("together", TOGETHER, ids=" and ".join)
def test_what_somebody_made_in_another_format_ends_with_a_reason_that_names_it(
    kinds, verbs, commands, tmp_path: Path, together: list[str]
) -> None:
    bad = []
    for made in together:
        kind, files = MADE[made]
        if kind not in kinds:
            continue  # ../shared is absent
        imports, *others = sorted(verbs(kind), key=lambda words: words[0] != "import")
        target, every = tmp_path / f"made{kinds[kind].suffix}", 1 if SOAK else EVERY.get(made, 25)
        for number, what in enumerate(islice(files(kinds[kind], target), 0, None, every)):
            if not SOAK:
                given = [(imports, *others)[number % len(verbs(kind))]]
            else:
                given = [imports, *(others if made in WHOLE else [others[number % len(others)]])]
            for words in given:
                outcome = commands.run([*words, target.name])
                if outcome.is_a_bug or (outcome.code == 7 and target.name not in outcome.text):
                    bad.append((what, json.dumps(outcome.words), outcome.code, outcome.text[-600:]))
                    print(*bad[-1], flush=True)
    assert bad == []


def photon_hdf5(path: Path) -> None:
    """Single photons as Photon-HDF5 lays them out (photon-hdf5.github.io), not timed against the laser."""
    with h5py.File(path, "w") as file:
        file.attrs.update({"format_name": b"Photon-HDF5", "format_version": b"0.5", "title": b"A measurement"})
        photons, rng = file.create_group("photon_data"), np.random.default_rng(0)
        photons["timestamps"] = np.sort(rng.integers(0, 2**40, 5000))
        photons["detectors"] = np.zeros(5000, np.uint8)
        photons["timestamps_specs/timestamps_unit"] = 1e-8
        file["setup/num_pixels"], file["acquisition_duration"] = 1, 10.0


def test_a_format_that_is_not_read_is_refused_by_name_by_every_verb(verbs, commands, tmp_path: Path) -> None:
    paths = [tmp_path / f"stranger{suffix}" for suffix in (".sdt", ".spc", ".ttbin", ".png", ".zip")]
    for path, raw in zip(paths, crafted_picoquant.OTHERS.values(), strict=True):
        path.write_bytes(raw)
    photon_hdf5(tmp_path / "photons.h5")
    for path in (*paths, tmp_path / "photons.h5"):
        for words in verbs("ptu"):
            outcome = commands.run([*words, path.name])
            told = words[0] == "info" and path.suffix == ".h5"  # what is in an HDF5 file is shown, whatever it is
            assert outcome.code == (0 if told else 7), outcome
            assert path.name in outcome.text
            assert not outcome.is_a_bug, outcome

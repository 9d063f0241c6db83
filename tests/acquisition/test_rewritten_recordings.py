"""Recordings that other programs have copied or packed: read all the same, or refused with what makes them readable."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import nlos
from nlos.__main__ import run
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import settle
from nlos.acquisition.recording.verification import verify
from tests.scan_texts import THREE_BY_FOUR, recorded


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return recorded(tmp_path, THREE_BY_FOUR)


def copy(source: h5py.Group, target: h5py.Group, **stored: Any) -> None:
    """All of a group, with its texts as bytes of a fixed length and notes of the program's own, as PyTables copies."""
    target.attrs["CLASS"], target.attrs["TITLE"] = np.bytes_("GROUP"), h5py.Empty("S1")
    for name, value in source.attrs.items():
        target.attrs[name] = np.bytes_(value) if isinstance(value, str) else value
    for name, item in source.items():
        if isinstance(item, h5py.Group):
            copy(item, target.create_group(name), **stored)
        else:
            target.create_dataset(name, data=item[()], **(stored if item.shape else {}))


def test_texts_of_a_fixed_length_and_notes_of_others_are_no_damage(recording: Path, tmp_path: Path) -> None:
    with h5py.File(recording) as source, h5py.File(tmp_path / "copy.h5", "w") as target:
        copy(source, target)
    with Recording.open(recording) as first, Recording.open(tmp_path / "copy.h5") as second:
        assert second.header == first.header
        assert second.plan.digest() == first.plan.digest()
        assert np.array_equal(second.transient().counts, first.transient().counts)
    assert run(["verify", str(tmp_path / "copy.h5")]) == 0


@pytest.mark.parametrize("length", [512, 4096])
def test_a_recording_behind_a_block_of_the_users_own_is_read(recording: Path, tmp_path: Path, length: int) -> None:
    """What `h5jam` makes, of a note on the sample say. None that is resumed is taken for a damaged one."""
    jammed = tmp_path / "jammed.h5"
    jammed.write_bytes(b"A hat. ".ljust(length, b"\0") + recording.read_bytes())
    assert nlos.load(jammed).counts.tobytes() == nlos.load(recording).counts.tobytes()
    for words in (["verify"], ["info"], ["recover", "-o", str(tmp_path / "again.h5")]):
        assert run([*words, str(jammed)]) == 0
    assert verify(tmp_path / "again.h5").complete
    with Recording.open(jammed) as found:
        plan = found.plan
    assert settle(jammed, plan)
    assert not list(tmp_path.glob("jammed.h5?*"))


@pytest.mark.parametrize("stored", [{"compression": "gzip"}, {"maxshape": (None,)}, {"chunks": True}])
def test_what_another_program_packed_is_refused_with_what_unpacks_it(
    recording: Path, tmp_path: Path, stored: dict[str, Any]
) -> None:
    with h5py.File(recording) as source, h5py.File(tmp_path / "packed.h5", "w") as target:
        copy(source, target)
        rows = source["plan/row"][()]
        del target["plan/row"]
        target["plan"].create_dataset("row", data=rows, **stored)
    with pytest.raises(InvalidData, match=r"plan/row: .*h5repack -f NONE -l CONTI .*packed\.h5 NEW\.h5"):
        Recording.open(tmp_path / "packed.h5")


def test_a_plans_attributes_lie_in_its_groups_header(recording: Path) -> None:
    """Beyond it, HDF5 1.10's h5copy crashes on those that are texts."""
    with h5py.File(recording) as file:
        most, _ = file["plan"].id.get_create_plist().get_attr_phase_change()
        assert len(file["plan"].attrs) <= most

"""Errors and warnings told in Python name arguments that Python's functions have, and one class catches them all."""

import ast
import inspect
import logging
import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import nlos
from nlos.python_words import in_python
from nlos.recon.errors import InvalidData, InvalidSettings
from tests.acquisition.importers.test_one_detector import two_channels

pytestmark = pytest.mark.usefixtures("one_child_reads")

ROOT = Path(__file__).parents[2]
COUNTS = np.random.default_rng(0).poisson(1.0, (8, 8, 64)).astype(np.uint16)
BIN_S = 64e-12
ARGUMENTS = {*inspect.signature(nlos.load).parameters, *inspect.signature(nlos.reconstruct).parameters} | {
    *inspect.signature(nlos.scan).parameters, "offsets", "falloff"
}  # fmt: skip


def of_arrays(path: Path, **stored: Any) -> Path:
    np.savez(path, **stored)
    return path


def of_matlab(path: Path) -> Path:
    savemat(path, {"rect_data": COUNTS})
    return path


CASES: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "bins of no width": ({"histograms": COUNTS}, {"wall": 1.0}, {"bin_width": BIN_S}),
    "a wall of no size": ({"histograms": COUNTS, "bin_width_s": BIN_S}, {}, {"wall": 1.0}),
    "time first": (
        {"histograms": COUNTS.transpose(2, 0, 1), "bin_width_s": BIN_S, "wall_size_m": 1.0},
        {},
        {"axes": "TYX"},
    ),
    "axes of another array": (
        {"histograms": COUNTS, "bin_width_s": BIN_S, "wall_size_m": 1.0}, {"axes": "TX"}, {"axes": "YXT"}
    ),
    "one detector": (
        {"histograms": COUNTS, "bin_width_s": BIN_S, "wall_size_m": 1.0}, {"detector": 1}, {"detector": None}
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_refusal_names_the_argument_that_helps(case: str, tmp_path: Path) -> None:
    stored, said, remedy = CASES[case]
    path = of_arrays(tmp_path / "lab.npz", **stored)
    for call in (nlos.load, nlos.reconstruct) if "detector" not in said else (nlos.load,):
        with pytest.raises(InvalidData) as raised:
            call(path, **said)
        told = str(raised.value)
        assert "--" not in told
        assert set(re.findall(r"(\w+)=", told)) <= ARGUMENTS
        assert re.search(rf"\b{next(iter(remedy))}\b", told.replace("wall_size_m", "").replace("bin_width_s", ""))
    assert nlos.load(path, **{**said, **remedy}).counts.sum() == COUNTS.sum()


def test_what_another_labs_file_needs_is_named_until_it_is_read(tmp_path: Path) -> None:
    path, known = of_matlab(tmp_path / "lab.mat"), dict[str, Any]()
    for name, value in (("bin_width", BIN_S), ("wall", 1.0), ("axes", "YXT")):
        with pytest.raises(InvalidData, match=rf"\b{name}\b") as raised:
            nlos.load(path, **known)
        assert "--" not in str(raised.value)
        known[name] = value
    assert nlos.load(path, **known).counts.sum() == COUNTS.sum()


def test_warnings_are_in_the_same_words(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    counts = np.zeros((8, 8, 256), np.uint16)
    counts[..., 40] = 500  # direct light at one later time
    path = of_arrays(tmp_path / "lab.npz", histograms=counts, bin_width_s=BIN_S, wall_size_m=1.0, rectified=True)
    with caplog.at_level(logging.WARNING):
        nlos.load(path).calibrated()
    assert "rectified=False, which aligns by it" in caplog.text
    assert "--" not in caplog.text


def test_one_detector_of_a_ptu_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "two.ptu"
    drawn = two_channels(path, (0, 1))  # by `ptufile`
    alone = [nlos.load(path, wall=1.0, detector=each).counts for each in (0, 1)]
    assert [each.sum() for each in alone] == [drawn[:, :, each].sum() for each in (0, 1)]
    with pytest.raises(InvalidData, match="detector=7: has no photons of it") as raised:
        nlos.load(path, wall=1.0, detector=7)
    assert "--" not in str(raised.value)


def test_offsets_of_a_file_are_taken_in_python_too(tmp_path: Path) -> None:
    late = np.random.default_rng(1).integers(10, 20, (8, 8))
    counts = np.zeros((8, 8, 128), np.uint16)
    np.put_along_axis(counts, late[..., None] + 50, 400, axis=2)  # 50 bins behind each point's own time 0
    path = tmp_path / "lab.h5"
    with h5py.File(path, "w") as file:
        file.attrs.update({"bin_width_s": BIN_S, "wall_size_m": 1.0, "rectified": 0})
        file["histograms"], file["time_offset_bins"] = counts, late.astype(float)
    picture = nlos.reconstruct(path, offsets="file")
    assert np.nanmedian(picture.depth_m) == pytest.approx(50 * BIN_S * 299_792_458 / 2, abs=0.05)
    with pytest.raises(InvalidSettings, match="only `offsets=file` is known"):
        nlos.reconstruct(path, offsets="mine")


@pytest.mark.parametrize("exposure_s", [1.0, 0.0])
def test_the_documented_class_catches_what_files_and_calibration_refuse(exposure_s: float, tmp_path: Path) -> None:
    """`nlos.recon.errors.InvalidData`, as the page "Use it from Python" says."""
    with pytest.raises(InvalidData):
        nlos.reconstruct(np.zeros((4, 4, 64)), wall=1.0, bin_width=BIN_S, exposure=np.full((4, 4), exposure_s),
                         rectified=False)  # fmt: skip
    torn = tmp_path / "torn.h5"
    torn.write_bytes(b"\x89HDF\r\n\x1a\nno more of it")
    with pytest.raises(InvalidData, match=r"torn\.h5"):
        nlos.load(torn)


def test_no_option_is_left_in_what_importers_calibration_and_methods_say() -> None:
    """Every string of theirs, whether a test above provokes it or not."""
    sources = [*(ROOT / "acquisition" / "importers").glob("*.py"), *(ROOT / "calibration").glob("*.py")]
    sources += [ROOT / "src" / "nlos" / f"{name}.py" for name in ("loaded", "chain", "file_doubts", "seemingly_raw")]
    found = 0
    for source in sources:
        for each in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(each, ast.Constant) and isinstance(each.value, str) and "--" in each.value:
                found += 1
                left = re.sub(r"`[^`]*`", "", in_python(each.value))
                assert not re.search(r"--[a-z]", left), f"{source}:{each.lineno}: {left}"
    assert found > 20  # so many there were; without any this looks in the wrong place


def test_commands_are_left_as_they_are() -> None:
    said = "Calibrate anew: `nlos calibrate RUN --spots FILE`, then --constants FILE."
    assert in_python(said) == "Calibrate anew: `nlos calibrate RUN --spots FILE`, then constants FILE."


def test_a_place_that_holds_no_results_is_refused_in_words(tmp_path: Path) -> None:
    picture = nlos.reconstruct(COUNTS, wall=1.0, bin_width=BIN_S, rectified=True)
    (tmp_path / "run.h5").touch()
    with pytest.raises(FileExistsError, match=r"run\.h5 is a file, not a folder\. Choose another place\.$"):
        picture.save(tmp_path / "run.h5")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "albedo.png").touch()
    with pytest.raises(FileExistsError, match=r"pass overwrite=True"):
        picture.save(tmp_path / "there")

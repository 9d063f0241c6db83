"""The LFE set's layout, written here byte by byte and read back."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.recon.training.lfe_set import lfe_scenes
from nlos.recon.training.radiance import read_radiance
from nlos.recon.training.scenes_on_disk import scene_files

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def rgbe(values: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    """(rows, cols, 3) -> (rows, cols, 4) bytes."""
    mantissa, exponent = np.frexp(values.max(axis=-1))
    scale = np.where(values.max(axis=-1) > 1e-30, mantissa * 256 / np.maximum(values.max(axis=-1), 1e-30), 0)
    coded = np.concatenate((values * scale[..., None], (exponent + 128)[..., None]), axis=-1)
    coded[values.max(axis=-1) <= 1e-30] = 0
    return coded.astype(np.uint8)


def flat(values: np.ndarray) -> bytes:  # type: ignore[type-arg]
    rows, cols, _ = values.shape
    return HEADER + f"-Y {rows} +X {cols}\n".encode() + rgbe(values).tobytes()


def run_length(values: np.ndarray) -> bytes:  # type: ignore[type-arg]
    """Runs where three and more bytes are alike, literal bytes elsewhere."""
    rows, cols, _ = values.shape
    out = HEADER + f"-Y {rows} +X {cols}\n".encode()
    for row in rgbe(values):
        out += bytes((2, 2, cols >> 8, cols & 255))
        for channel in row.T:
            at = 0
            while at < cols:
                run = 1
                while at + run < cols and run < 127 and channel[at + run] == channel[at]:
                    run += 1
                out += bytes((128 + run, channel[at])) if run > 2 else bytes((run, *channel[at : at + run]))
                at += run
    return out


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 5), st.integers(8, 300))
def test_flat_and_coded_pictures_read_alike(
    tmp_path_factory: pytest.TempPathFactory, seed: int, rows: int, cols: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.gamma(0.3, 100.0, (rows, cols, 3)) * (rng.random((rows, cols, 1)) < 0.4)
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    path.write_bytes(run_length(values))
    coded = read_radiance(path)
    path.write_bytes(flat(values))
    np.testing.assert_array_equal(read_radiance(path), coded)
    np.testing.assert_allclose(coded, values, atol=values.max() / 100)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_picture_is_refused_or_read_never_more(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    whole = bytearray(run_length(np.random.default_rng(0).gamma(0.3, 10.0, (3, 20, 3))))
    del whole[data.draw(st.integers(0, len(whole))) :]
    if whole:
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    path.write_bytes(bytes(whole))
    try:
        picture = read_radiance(path)
    except ValueError as error:
        assert str(path) in str(error)  # noqa: PT017 - either outcome is right, but an error must name the file
    else:
        assert picture.ndim == 3


def scene_folder(root: Path, model: str) -> Path:
    folder = root / "0" / model / "shine_0-rot_1_2_3-shift_0_0_0"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    (folder / "light-1-3.5-2-1.hdr").write_bytes(flat(rng.random((40 * 16, 16, 3))))
    (folder / "confocal-0-1-0.hdr").write_bytes(flat(rng.random((16, 16, 3)) * 7))
    (folder / "depth-0-1-0.hdr").write_bytes(flat(rng.random((16, 16, 3)) * 2))
    return folder


def test_a_scene_becomes_a_transient_with_its_axes(tmp_path: Path) -> None:
    scene_folder(tmp_path, "m1")
    (scene,) = lfe_scenes(tmp_path / "0", "train")
    transient = scene.transient(bins=40)
    assert transient.counts.shape == (40, 16, 16)
    assert transient.time.bin_width_s == pytest.approx(33.356e-12, rel=1e-4)
    assert transient.wall.width_m == 2.0
    assert scene.picture().max() == 1
    assert 0 <= scene.nearness().min() <= scene.nearness().max() <= 1
    with pytest.raises(ValueError, match="512 square frames"):
        scene.transient()
    with pytest.raises(FileNotFoundError, match="light-2"):
        scene.transient("detector", bins=40)


def test_models_split_as_published_in_a_training_file(tmp_path: Path) -> None:
    for k in range(252):
        (tmp_path / "0" / f"{k:04d}" / "shine_0").mkdir(parents=True)
    held_out, learned = scene_files(f"{tmp_path}/0:test"), scene_files(f"{tmp_path}/0:train")
    assert [path.parent.name for path in held_out] == ["0000", "0001"]
    assert len(learned) == 250
    assert scene_files(f"{tmp_path}/0/*/shine_*") == sorted(held_out + learned)
    assert scene_files(f"{tmp_path}/1:train") == []

"""A scan of four frames through every way in and out: its photons stay what they were, and a picture explains them."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.chain import reconstruct_file
from nlos.cli.app import load_verb
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.loaded import load_scan
from nlos.recipe import Recipe
from nlos.results_folder import ResultsFolder

Verb = Callable[..., None]
BENCHES = {"optotune": 32.0, "simulated": 32.0, "multiharp": 40.0, "helios": 32.0, "timetagger": 32.0}
"""Stepped by the host, by the counter's clock, sorted from a stream of photons, by the mirror's own clock."""


def taken(folder: Path, bench: str, frames: int, interleave: int = 1, side: int = 8) -> Path:
    words = {
        "wall": {"width_m": 1.0, "height_m": 1.0, "rows": side, "cols": side}, "pattern": "serpentine", "dwell_ms": 2,
        "histogram": {"bins": 512, "bin_width_ps": BENCHES[bench], "offset_ns": 9.6}, "frames": frames,
        "interleave": interleave,
    }  # fmt: skip
    path = folder / "run.h5"
    with open_bench(load("bench", bench, BenchSettings).settings) as there:
        plan = ScanSettings.model_validate(words).plan()
        plan = plan.on_axis(there.counter.nearest_axis(plan.axis))
        header = Header(bench_json=there.settings.model_dump_json())
        with RecordingWriter.create(path, plan, header, clock=there.clock) as writer:
            record(scan(plan, there), writer)
    return path


def photons(path: Path, frame: int | None = None) -> float:
    frames = None if frame is None else range(frame, frame + 1)
    return float(load_scan(path, frames=frames).transient.counts.sum(dtype="float64"))


@pytest.fixture
def nlos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Verb:
    """A command, in this process."""
    monkeypatch.chdir(tmp_path)

    def call(verb: str, *words: str) -> None:
        load_verb(verb).main([*words], standalone_mode=False)

    return call


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("bench", "interleave"),
    [("optotune", 1), ("simulated", 4), ("multiharp", 4), ("helios", 1), ("timetagger", 1)],
)
def test_a_film_keeps_its_photons_through_every_verb(bench: str, interleave: int, nlos: Verb, tmp_path: Path) -> None:
    run = taken(tmp_path, bench, 4, interleave, side=5)
    each = [photons(run, frame) for frame in range(4)]
    assert photons(run) == sum(each) > 1000
    nlos("replay", "run.h5", "--speed", "max", "-o", "again.h5")
    nlos("recover", "run.h5", "-o", "rescued.h5")
    for copy in ("again.h5", "rescued.h5"):
        assert verify(tmp_path / copy).complete_frames == 4
        assert [photons(tmp_path / copy, frame) for frame in range(4)] == each
    nlos("export", "run.h5", "--to", "npz,gif")
    nlos("import", "run.npz", "-o", "back.h5")
    assert photons(tmp_path / "back.h5") == sum(each)
    nlos("reconstruct", "run.h5", "--film", "-o", "film")
    pictures = json.loads((tmp_path / "film" / "track.json").read_text())
    assert [row["frame"] for row in pictures] == list(range(interleave - 1, 4))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["lct", "fk", "backprojection", "gram"])
def test_a_scan_of_few_points_is_explained_by_methods_that_add_bins_up(method: str, tmp_path: Path) -> None:
    """Points 12 cm apart have bins of 128 ps: noise is told from light in the bins that were measured."""
    run = taken(tmp_path, "simulated", 1)
    done = reconstruct_file(run, Recipe(method, constants=Path("none")), ResultsFolder(tmp_path / "out", volume=False))
    assert done.explained is not None
    assert done.explained.share is not None
    assert done.explained.share > 0.3, str(done.explained)

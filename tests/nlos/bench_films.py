"""Films of the shipped benches with something that moves."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

import nlos
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.engine import record, scan
from nlos.configs.load import find, load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.simulated.surfaces import Surface

WORDS = {
    "wall": {"width_m": 1.0, "height_m": 1.0, "rows": 12, "cols": 12},
    "pattern": "serpentine",
    "dwell_ms": 1,
    "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 10},
    "frames": 8,
}
"""Eight frames of 12 x 12 points, 2.8 s."""


def filmed(path: Path, words: Mapping[str, Any]) -> Path:
    """A scan file's `words`, recorded to `path` on the bench whose letter moves."""
    return _filmed(path, words, load("bench", "moving", BenchSettings).settings)


def filmed_objects(path: Path, interleave: int, *objects: Mapping[str, object]) -> Path:
    """`WORDS` on the default bench with these objects in place of its own."""
    return _filmed(path, {**WORDS, "interleave": interleave}, bench_with(*objects))


def bench_with(*objects: Mapping[str, object]) -> BenchSettings:
    """The default bench with these objects in place of its own."""
    settings = load("bench", "simulated", BenchSettings).settings
    assert settings.simulation is not None
    surfaces = tuple(Surface.model_validate_json(json.dumps(each)) for each in objects)
    scene = settings.simulation.scene.model_copy(update={"objects": surfaces})
    return settings.model_copy(update={"simulation": settings.simulation.model_copy(update={"scene": scene})})


def plan_of(words: Mapping[str, Any]) -> ScanPlan:
    """The plan of a scan file's words."""
    return ScanSettings.model_validate_json(json.dumps(words)).plan()


def _filmed(path: Path, words: Mapping[str, Any], settings: BenchSettings) -> Path:
    plan = plan_of(words)
    with open_bench(settings) as bench, RecordingWriter.create(path, plan, Header(), clock=bench.clock) as writer:
        record(scan(plan, bench), writer)
    return path


def taken_by_hand(
    bench: str | Path, scan_file: Path, run: Path, samples: int | None = None, resume: bool = False
) -> list[Sample]:
    """So many more samples into `run`, all unless given; then whoever asked for them goes away."""
    got = []
    with nlos.open_bench(bench) as table:
        coming = nlos.scan(scan_file, table, output=run, resume=resume)
        for sample in coming:
            got.append(sample)
            if len(got) == samples:
                coming.close()
                break
    return got


def bench_file(path: Path, *objects: Mapping[str, object]) -> Path:
    """The same bench as a file."""
    words = yaml.safe_load(find("bench", "simulated").read_text())
    words["simulation"]["scene"]["objects"] = [json.loads(json.dumps(each)) for each in objects]
    path.write_text(yaml.safe_dump(words))
    return path

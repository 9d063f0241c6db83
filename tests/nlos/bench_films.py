"""Films of the shipped bench with something that moves."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench


def filmed(path: Path, words: Mapping[str, Any]) -> Path:
    """A scan file's `words`, recorded to `path`."""
    plan = ScanSettings.model_validate_json(json.dumps(words)).plan()
    settings = load("bench", "moving", BenchSettings).settings
    with open_bench(settings) as bench, RecordingWriter.create(path, plan, Header(), clock=bench.clock) as writer:
        record(scan(plan, bench), writer)
    return path

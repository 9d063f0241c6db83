"""A recording is resumed with the calibration constants it was begun with, as far as it says which."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.acquisition.recording.verification import verify
from tests.acquisition.test_resuming import sample, write

CONSTANTS = {
    "measured_utc": "2026-03-01T10:00:00+00:00", "bench": "lab", "sources": ["a.h5"], "devices": {"mirror": "m 1"},
    "geometry": {"wall_distance_m": 1.02, "x_gain": 0.998}, "delay_s": 4.2e-9,
    "dark_hz": {"value": 210.0, "error": 3.0},
    "ambient_hz": None, "dead_time_s": None, "afterpulse_probability": None,
}  # fmt: skip


def header_of(constants: dict[str, object]) -> Header:
    return Header(scan_text="a scan", constants_json=json.dumps(constants))


def test_a_recording_begun_before_constants_had_all_their_keys_is_resumed(
    small_plan: Callable[..., ScanPlan], tmp_path: Path
) -> None:
    """As the version before wrote it: no `bench`, no gain in the geometry. What it did write has to agree."""
    plan = small_plan(2, 3)
    old = {**CONSTANTS, "geometry": {"wall_distance_m": 1.02}}
    del old["bench"]
    path = write(tmp_path / "old.h5", plan, 4, header=header_of(old))
    resumed = resume(path, plan, header_of(CONSTANTS))
    assert resumed.writer is not None
    assert sorted(resumed.taken) == [0, 1, 2, 3]
    with resumed.writer as writer:
        for number in (4, 5):
            writer.write(sample(plan, number))
    assert verify(path).complete
    with Recording.open(path) as recording:
        assert json.loads(recording.header.constants_json) == old


@pytest.mark.parametrize(
    ("then", "now", "what"),
    [
        (CONSTANTS, {**CONSTANTS, "bench": "other"}, 'bench: "lab" then, "other" now'),
        (CONSTANTS, {**CONSTANTS, "geometry": {"wall_distance_m": 1.02, "x_gain": 0.997}}, "x_gain: 0.998 then"),
        (CONSTANTS, {**CONSTANTS, "geometry": None}, "geometry: "),
        (CONSTANTS, {**CONSTANTS, "dark_hz": {"value": 211.0, "error": 3.0}}, "value: 210.0 then, 211.0 now"),
        (
            CONSTANTS,
            {key: value for key, value in CONSTANTS.items() if key != "delay_s"},
            "delay_s: 4.2e-09 then, null",
        ),
        ({}, CONSTANTS, "constants: {} then"),
        (CONSTANTS, {}, "now"),
    ],
)
def test_a_recording_is_not_resumed_with_other_constants(
    small_plan: Callable[..., ScanPlan],
    tmp_path: Path,
    then: dict[str, object],
    now: dict[str, object],
    what: str,
) -> None:
    plan = small_plan(2, 3)
    path = write(tmp_path / "run.h5", plan, 4, header=header_of(then))
    with pytest.raises(ResumeRefused, match=re.escape(what)):
        resume(path, plan, header_of(now))

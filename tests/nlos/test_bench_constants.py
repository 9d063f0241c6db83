"""Constants belong to a bench: found by its name from any folder, said with what they override, refused once stale."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording
from nlos.bench_constants import NONE, aiming_constants, correcting_constants, folder_of, measured_later
from nlos.calibration.arrivals import Arrivals
from nlos.calibration.bench_facts import facts_of
from nlos.calibration.constants import BenchConstants, save
from nlos.calibration.errors import ForeignConstants, StaleConstants
from nlos.calibration.geometry import ScannerGeometry
from nlos.configs.load import find, parse
from nlos.drivers.bench import BenchSettings
from nlos.drivers.file_word import older_word
from tests.nlos.conftest import SMALL

DEVICES = {"mirror": "triggerscope ", "counter": "tcspc488 SIM0001"}
SPOTS = {"x_gain": 1e-4, "wall_distance_m": 1e-3}
BENCH: dict[str, Any] = yaml.safe_load(find("bench", "simulated").read_text())


def bench_json(**changed: Any) -> str:
    """The simulated bench's file, with some blocks changed."""
    return parse(yaml.safe_dump(with_changes(changed)), "b.yaml", BenchSettings).model_dump_json()


def with_changes(changed: dict[str, Any]) -> dict[str, Any]:
    return {key: {**value, **changed.get(key, {})} if isinstance(value, dict) else changed.get(key, value)
            for key, value in BENCH.items()}  # fmt: skip


def constants(**more: Any) -> BenchConstants:
    """Those of a bench whose wall is a little further away than its file says."""
    name, facts = facts_of(bench_json())
    x_m = np.array([-0.1, 0.1])
    arrivals = Arrivals(np.array([0.0, 0.0, 2.0]), 1e-9, np.eye(4), 1e-12, x_m, x_m, np.zeros(2))
    made = BenchConstants(
        {"mirror": DEVICES["mirror"].strip(), "counter": DEVICES["counter"]}, "2026-03-01T12:00:00+00:00", ("a.h5",),
        16e-12, arrivals=arrivals, geometry=ScannerGeometry(2.03, scanner_x_m=0.25), geometry_errors=SPOTS,
        bench=name, bench_facts=facts,
    )  # fmt: skip
    return replace(made, **more)


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What outlasts a program: the constants of the simulated bench. Once a module, as a child reads each file once."""
    folder = tmp_path_factory.mktemp("state") / "constants" / BENCH["name"]
    folder.mkdir(parents=True)
    save(constants(), folder / "spots.h5")
    return folder.parents[1]


@pytest.fixture
def kept(state: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The file that is kept with the bench; the command runs in another folder."""
    monkeypatch.setenv("NLOS_STATE", str(state))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(SMALL)
    return folder_of(BENCH["name"]) / "spots.h5"


def devices_now() -> dict[str, str]:
    return {"mirror": DEVICES["mirror"].strip(), "counter": DEVICES["counter"]}


def test_they_are_found_by_the_benchs_name_and_say_what_they_override(kept: Path) -> None:
    known = aiming_constants(None, bench_json(), devices_now())
    assert known is not None
    assert known.path == kept
    drawn = ScannerGeometry(2.0)
    assert "wall_distance_m 2.0300 m (file 2)" in known.said(drawn)
    assert "scanner_x_m 0.2500 m (file 0)" in known.said(drawn)
    assert "y_gain" not in known.said(drawn)
    assert aiming_constants(None, bench_json(name="another"), devices_now()) is None
    assert aiming_constants(NONE, bench_json(), devices_now()) is None


@pytest.mark.sampled(2)
@pytest.mark.parametrize("others", ["光学台", "bench-1"])
@pytest.mark.parametrize("own", ["実験台", "bench 1"])
def test_another_benchs_constants_never_aim_this_one_however_alike_their_names(
    own: str, others: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor those in a folder that an earlier version let them share, where its own ones are still found."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    assert folder_of(own) != folder_of(others)
    shared = folder_of(own).with_name(older_word(own))
    for folder in (folder_of(own), shared):
        folder.mkdir(parents=True)
        save(constants(bench=others, measured_utc="2026-04-01T12:00:00+00:00"), folder / "others.h5")
    assert aiming_constants(None, bench_json(name=own), {}) is None
    save(constants(bench=own, measured_utc="2026-03-02T12:00:00+00:00"), shared / "older.h5")
    for name in ("older.h5", "own.h5"):
        known = aiming_constants(None, bench_json(name=own), {})
        assert known is not None
        assert known.path.name == name
        save(constants(bench=own, measured_utc="2026-03-03T12:00:00+00:00"), folder_of(own) / "own.h5", overwrite=True)


def test_constants_that_a_wrong_clock_dated_later_are_found_beside_those_measured_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would be taken for the newest, whatever is measured until then."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    name = BENCH["name"]
    for path, when in (("before", "2026-03-02T12:00:00+00:00"), ("now", "2026-03-03T12:00:00+00:00")):
        folder_of(name).mkdir(parents=True, exist_ok=True)
        save(constants(bench=name, measured_utc=when), folder_of(name) / f"{path}.h5")
    assert measured_later(folder_of(name) / "now.h5", name) is None
    assert measured_later(folder_of(name) / "before.h5", name) == folder_of(name) / "now.h5"


CHANGED = {
    "distance": {"geometry": {"wall_distance_m": 1.42}},
    "lever": {"geometry": {"mirror_separation_m": 0.01}},
    "mounting": {"mirror": {"x": {"dac": 1, "volts_per_degree": -0.5}}},
    "swapped axes": {"mirror": {"x": {"dac": 2}, "y": {"dac": 1}}},
    "cable": {"counter": {"detector": {"delay_ps": 500}}},
    "level": {"counter": {"sync": {"level_mv": -300}}},
    "laser": {"laser": {"repetition_hz": 20e6}},
}


@pytest.mark.parametrize("what", CHANGED)
def test_a_bench_that_changed_makes_them_stale(kept: Path, what: str) -> None:
    now = bench_json(**CHANGED[what])
    with pytest.raises(StaleConstants, match=r"then, .* now.*--constants none.*--constants /"):
        aiming_constants(None, now, devices_now())
    named = aiming_constants(kept, now, devices_now())
    assert named is not None
    assert "has changed since" in named.warning
    assert correcting_constants(None, now, devices_now(), 16e-12) is None


@pytest.mark.parametrize("block", [{"mirror": {"timeout_s": 1.0}}, {"safety": {"trip_cps": 1e6}},
                                   {"counter": {"over_count": {"rate_hz": 1000}}},
                                   {"geometry": {"allowed": {"left_m": -1.0, "right_m": 1.0, "bottom_m": -1.0,
                                                             "top_m": 1.0}}}])  # fmt: skip
def test_what_moves_neither_beam_nor_time_does_not(kept: Path, block: dict[str, Any]) -> None:
    assert aiming_constants(None, bench_json(**block), devices_now()) is not None


def test_another_serial_number_is_another_bench(kept: Path) -> None:
    other = {**devices_now(), "counter": "tcspc488 C-9"}
    with pytest.raises(StaleConstants, match="counter tcspc488 SIM0001 then, tcspc488 C-9 now"):
        aiming_constants(None, bench_json(), other)
    assert aiming_constants(None, bench_json(), {}) is not None  # nobody opened them: plan
    with pytest.raises(ForeignConstants, match="for the counter"):
        aiming_constants(kept, bench_json(), {"counter": "picoquant 7"})


OTHER_KIND = {
    "a rehearsal's": ("simulated", "real", "it was measured on a simulated bench of this name, and this one is real"),
    "the real bench's": ("real", "simulated", "on a real bench of this name, and this one is simulated"),
    "of nobody knows which": (None, "real", "it does not say whether it is of a simulated bench, and this one is real"),
}


@pytest.mark.parametrize("kind", OTHER_KIND)
def test_those_of_the_other_kind_of_bench_are_passed_over_and_said(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """They neither aim nor refuse the bench of the same name, and are no newer than its own."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    then, now, why = OTHER_KIND[kind]
    text = {"simulated": bench_json(), "real": real_json()}
    facts = {key: value for key, value in facts_of(text[then or now])[1].items() if then or key != "instruments"}
    folder = folder_of(BENCH["name"])
    folder.mkdir(parents=True)
    path = folder / "newer.h5"
    save(constants(measured_utc="2026-04-01T12:00:00+00:00", bench_facts=facts), path)
    assert aiming_constants(None, text[now], {}) is None
    assert f"{path} passed over: " in caplog.text
    assert why in caplog.text
    assert f"--constants {path}" in caplog.text
    named = aiming_constants(path, text[now], {})
    assert named is not None
    assert bool(then) == (f"instruments {then} then, {now} now" in named.warning)
    assert correcting_constants(None, text[now], {}, 16e-12) is None
    save(constants(bench_facts=facts_of(text[now])[1]), folder / "own.h5")
    own = aiming_constants(None, text[now], {})
    assert own is not None
    assert own.path.name == "own.h5"


def test_plan_aims_no_real_bench_by_a_rehearsal(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("real.yaml").write_text(yaml.safe_dump(json.loads(real_json())))
    assert run(["plan", "small.yaml", "--bench", "real.yaml"]) == 0
    said = capsys.readouterr().err
    assert f"warning: constants: {kept} passed over" in said
    assert "in place of the bench file" not in said


def real_json() -> str:
    """The simulated bench with cables instead."""
    real = {key: value for key, value in BENCH.items() if key != "simulation"}
    real["mirror"], real["counter"] = real["mirror"] | {"port": "/dev/ttyACM0"}, real["counter"] | {"usb": "auto"}
    return parse(yaml.safe_dump(real), "r.yaml", BenchSettings).model_dump_json(exclude_none=True)


def test_only_the_newest_tells_how_the_bench_is_now(kept: Path) -> None:
    moved = facts_of(bench_json(geometry={"wall_distance_m": 1.42}))[1]
    later = kept.with_name("later.h5")
    save(constants(measured_utc="2026-04-01T12:00:00+00:00", bench_facts=moved), later)
    try:
        with pytest.raises(StaleConstants, match=r"later\.h5.*wall_distance_m 1\.42 then, 2 now"):
            aiming_constants(None, bench_json(), devices_now())
        back = correcting_constants(None, bench_json(), devices_now(), 16e-12)  # a scan of before the move
    finally:
        later.unlink()
    assert back is not None
    assert back.path == kept


@pytest.mark.parametrize("verb", [["plan", "small.yaml"], ["scan", "small.yaml", "-o", "run.h5"]])
def test_plan_and_scan_take_the_same_and_refuse_the_same(
    kept: Path, verb: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(verb) == 0
    said = capsys.readouterr().err
    assert f"constants: {kept}" in said
    assert "wall_distance_m 2.0300 m (file 2)" in said
    Path("moved.yaml").write_text(yaml.safe_dump(with_changes({"geometry": {"wall_distance_m": 1.42}})))
    moved = [*verb, "--bench", "moved.yaml", *(["--overwrite"] if verb[0] == "scan" else [])]
    assert run(moved) == 7
    assert "wall_distance_m 2 then, 1.42 now" in capsys.readouterr().err
    assert run([*moved, "--constants", "none"]) == 0
    assert "constants:" not in capsys.readouterr().err
    assert run([*moved, "--constants", str(kept)]) == 0
    assert "warning: " + str(kept) in capsys.readouterr().err


def test_a_recording_keeps_which_it_was_aimed_by_and_info_says_so(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["scan", "small.yaml", "-o", "run.h5"]) == 0
    with Recording.open(Path("run.h5")) as recording:
        used = json.loads(recording.header.constants_json)
    assert used["bench"] == BENCH["name"]
    assert used["geometry"]["scanner_x_m"] == 0.25
    capsys.readouterr()
    assert run(["info", "run.h5"]) == 0
    assert "those of 2026-03-01T12:00:00+00:00, of bench simulated, aimed it" in capsys.readouterr().out


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("given", "times"), [("kept", 2), ("none", 0)])
def test_a_scans_picture_is_corrected_by_what_the_scan_was_given(
    kept: Path, given: str, times: int, capsys: pytest.CaptureFixture[str]
) -> None:
    named = str(kept) if given == "kept" else given
    assert run(["scan", "small.yaml", "-o", "run.h5", "--constants", named, "--reconstruct", "lct", "-v"]) == 0
    assert capsys.readouterr().err.count(f"constants: {kept}") == times
    assert run(["live", "run.h5", "--method", "lct", "--constants", named, "--idle-s", "0", "-v"]) == 0
    assert capsys.readouterr().err.count(f"constants: {kept}") == times // 2

"""`nlos new bench`: whatever is answered, a file that loads, says what every line means, and hears its own pulses."""

import itertools
import os
import pty
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest
import yaml

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.scanning.alarms import AlarmSettings
from nlos.cli.exit_codes import UsageError
from nlos.cli.new import new
from nlos.configs.load import ConfigError, load, names, parse
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.link.same_device import PortInfo
from nlos.drivers.tcspc.block import CounterBlock
from nlos.drivers.tcspc.known_counters import COUNTERS
from nlos.new_bench import detection
from nlos.new_bench.asking import answers
from nlos.new_bench.detection import Detected, devices_of
from nlos.new_bench.hints import HINTS
from nlos.new_bench.questions import questions
from nlos.new_bench.unfinished import Unfinished
from nlos.new_bench.writing import bench_text, blocks_of
from nlos.scan_preparation import ScanRequest, prepare

NOTHING = Detected((), (), ())
KINDS = [(word, device) for word, model in COUNTERS.items() for device in devices_of(model.settings) or ("",)]


def answered(simulated: bool, **given: str) -> dict[str, str]:
    """Every question with its default, but for those that are `given`."""
    said: dict[str, str] = {}
    for ask in questions(NOTHING, simulated):
        if (question := ask(said)) is not None:
            answer = given.get(question.key, question.default)
            assert answer is not None, question
            assert not question.refusal(answer), question
            said[question.key] = answer
    return said


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("mirror", MIRRORS)
@pytest.mark.parametrize(("counter", "device"), KINDS)
def test_every_pair_of_instruments_makes_a_file_that_loads(
    mirror: str, counter: str, device: str, simulated: bool, tmp_path: Path
) -> None:
    for pulse in ("nim", "ttl"):
        given = {"mirror": mirror, "counter": counter, "device": device, "detector_pulse": pulse,
                 "wall_distance_m": "1.42", "scanner_x_m": "-0.25", "repetition_hz": "20e6"}  # fmt: skip
        try:
            said = answered(simulated, **given)
        except AssertionError:  # a pulse that this counter does not take is not among the choices
            assert (pulse, device) in itertools.product(["ttl"], ["picoharp300", "hydraharp400"])
            continue
        text = bench_text(blocks_of("mine", said, simulated))
        settings = parse(text, "mine.yaml", BenchSettings)
        assert settings.simulated == simulated
        assert settings.geometry.wall_distance_m == 1.42
        assert settings.laser.repetition_hz == 20e6
        assert settings.geometry.scanner_x_m == -0.25
        lines = text.splitlines()
        for number, line in enumerate(lines):
            own = line.strip()
            assert "#" in own or lines[number - 1].strip().startswith("#") or not own, f"says not what it means: {own}"
        assert all(len(line) <= 120 for line in lines)


@pytest.mark.parametrize(("counter", "device"), KINDS)
def test_a_counter_with_its_defaults_hears_laser_and_detector(counter: str, device: str) -> None:
    said = answered(True, counter=counter, device=device)
    settings = parse(bench_text(blocks_of("mine", said, True)), "mine.yaml", BenchSettings)
    with open_bench(settings) as bench:
        bench.clock.sleep(0.5)
        rates = bench.counter.rates()
    assert rates.sync_hz == pytest.approx(10e6, rel=1e-3)
    assert rates.detector_hz > 0


@pytest.mark.parametrize("counter", ["picoquant", "tcspc488", "timetagger"])
def test_a_counter_hears_ttl_pulses_and_the_file_says_what_they_need(
    counter: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "b.yaml"
    given = [f"counter={counter}", "sync_pulse=ttl", "detector_pulse=ttl"]
    assert new("bench", file, None, given, True, False, False) == 0
    made = 2 if counter != "timetagger" else 0  # its levels reach 2.5 V: TTL is what it is made for
    assert file.read_text().count("put an attenuator to below 1.2 V") == made
    assert capsys.readouterr().err.count("put an attenuator to below 1.2 V") == made
    settings = load("bench", str(file), BenchSettings).settings
    assert settings.counter.sync.level_mv == settings.counter.detector.level_mv  # type: ignore[attr-defined]
    assert settings.counter.sync.level_mv == (300 if made else 500)  # type: ignore[attr-defined]
    with open_bench(settings) as bench:
        bench.clock.sleep(0.5)
        rates = bench.counter.rates()
    assert rates.sync_hz == pytest.approx(10e6, rel=1e-3)
    assert rates.detector_hz > 0


@pytest.mark.parametrize(
    ("counter", "device", "mirror"),
    [(*kind, mirror) for kind, mirror in zip(KINDS, itertools.cycle(("optotune", "helios")))],
)
def test_every_shipped_scan_plans_on_what_is_written(counter: str, device: str, mirror: str, tmp_path: Path) -> None:
    said = answered(True, mirror=mirror, counter=counter, device=device)
    with open_bench(parse(bench_text(blocks_of("mine", said, True)), "mine.yaml", BenchSettings)) as bench:
        for name in names("scan"):
            plan = load("scan", name, ScanSettings).settings.plan()
            request = ScanRequest(plan, AlarmSettings(), Header(), tmp_path / "run.h5")
            if plan.stop is not None and counter != "tcspc488":  # the others have no such thing
                with pytest.raises(LimitError, match="two_pass"):
                    prepare(request, bench)
            else:
                assert len(prepare(request, bench).request.plan) == len(plan)


def test_off_a_terminal_defaults_are_taken_and_what_has_none_is_asked_for(tmp_path: Path) -> None:
    file = tmp_path / "b.yaml"
    with pytest.raises(UsageError, match="--answer wall_distance_m="):
        new("bench", file, None, [], False, False, False)
    assert not file.exists()
    code = new("bench", file, None, ["wall_distance_m=1.4"], True, False, False)
    assert code == 0
    assert load("bench", str(file), BenchSettings).settings.name == "b"
    with pytest.raises(FileExistsError, match="--overwrite"):
        new("bench", file, None, [], True, False, False)
    for wrong, why in (
        ("wall_distance_m=far", "not a number"),
        ("mirror=acme", "not one of"),
        ("colour=red", "no such question"),
    ):
        with pytest.raises(UsageError, match=why):
            new("bench", tmp_path / "c.yaml", None, [wrong], True, False, False)


def test_inputs_are_named_as_printed_on_the_front() -> None:
    text = (Path(__file__).parents[2] / "configs/bench/multiharp.yaml").read_text()
    old = yaml.safe_load(text)
    assert parse(text, "m.yaml", BenchSettings).counter.channel == 0  # type: ignore[attr-defined]
    old["counter"]["channel"] = 2
    with pytest.raises(ConfigError, match="write `input: 3`"):
        parse(yaml.safe_dump(old), "m.yaml", BenchSettings)


def test_degrees_say_of_what_they_are() -> None:
    page = (Path(__file__).parents[2] / "docs/settings/bench.md").read_text().split("# Bench files")[1]
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) < 5 or "deg" not in cells[1].strip("`").split("_"):
            continue
        words = " ".join(cells).lower()
        assert any(word in words for word in ("mechanical", "optical", "edge", "beam")), line


@pytest.fixture
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], None]]:
    """Lines typed at a terminal, a real one; what is typed beyond the last line is the end of it."""
    inner, outer = pty.openpty()
    with os.fdopen(outer) as typed:
        monkeypatch.setattr("sys.stdin", typed)

        def type_in(text: str) -> None:
            os.write(inner, text.encode())

        yield type_in
    os.close(inner)


def test_on_a_terminal_one_goes_back_and_what_was_typed_is_kept(
    at_a_terminal: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    # wrong answers; twice back, to another mirror, which has no volts; the first question has none before it
    at_a_terminal("acme\noptotune\n<\n<\ntriggerscope\n0.25\n9\n<\n\n" + "\n" * 30)
    said = answers(questions(NOTHING, True), {})
    assert said["mirror"] == "triggerscope"
    assert (said["volts_per_degree"], said["max_mechanical_deg"]) == ("0.25", "9")
    assert said == answered(True, mirror="triggerscope", volts_per_degree="0.25", max_mechanical_deg="9")
    words = capsys.readouterr().err
    assert "'acme' is not one of triggerscope" in words
    assert "this is the first question" in words
    assert "goes back" in words


def test_a_terminal_that_ends_writes_nothing(at_a_terminal: Callable[[str], None], tmp_path: Path) -> None:
    at_a_terminal("optotune\n\x04")
    with pytest.raises(UsageError, match="No bench file was written"):
        new("bench", tmp_path / "b.yaml", None, [], True, False, False)
    assert not list(tmp_path.glob("*.yaml"))


def test_answers_of_a_broken_off_time_are_offered_again_once(
    at_a_terminal: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "new" / "b.yaml"
    at_a_terminal("triggerscope\n0.31\n\x04")
    with pytest.raises(UsageError):
        new("bench", target, None, [], True, False, False)
    assert "your answers so far; the same command offers them again" in capsys.readouterr().err
    (kept,) = target.parent.iterdir()
    with pytest.raises(ConfigError):  # no verb takes it for a bench
        load("bench", str(kept), BenchSettings)
    at_a_terminal("\n" * 30)
    assert new("bench", target, None, [], True, False, False) == 0
    assert "[0.31]" in capsys.readouterr().err
    assert load("bench", str(target), BenchSettings).settings.mirror.x.volts_per_degree == 0.31  # type: ignore[union-attr]
    assert [each.name for each in target.parent.iterdir()] == ["b.yaml"]


def test_answers_for_a_simulated_bench_are_not_offered_for_a_real_one(tmp_path: Path) -> None:
    Unfinished(tmp_path / "b.yaml", "simulated").keep({"wall_distance_m": "3"})
    assert Unfinished(tmp_path / "b.yaml", "real").load() == {}
    assert Unfinished(tmp_path / "b.yaml", "simulated").load() == {"wall_distance_m": "3"}
    (tmp_path / "b.yaml.answers").write_text('{"bench": "simulated", "answers": [')
    assert Unfinished(tmp_path / "b.yaml", "simulated").load() == {}


def test_a_counter_of_other_keys_is_asked_no_more_than_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a package of its own brings one."""

    class Acme(CounterBlock):
        model: Literal["acme"]
        cable = "usb"
        usb: str

    monkeypatch.setitem(COUNTERS, "acme", replace(COUNTERS["tcspc488"], settings=Acme, shutters={}))
    nothing = Detected((), (), ())
    given = {"mirror": "optotune", "port": "COM3", "counter": "acme", "wall_distance_m": "2", "repetition_hz": "1e7"}
    said = answers(questions(nothing, simulated=False), given)
    assert not {"sync_pulse", "detector_pulse", "sync_input", "detector_input"} & said.keys()
    assert blocks_of("acme", said, simulated=False)["counter"] == {"model": "acme", "usb": "auto"}


def test_every_question_has_a_hint() -> None:
    keys = set()
    for mirror, (counter, device) in itertools.product(MIRRORS, KINDS):
        for simulated in (False, True):
            more = {"device": device} if device else {}
            given = {"wall_distance_m": "1.4", "repetition_hz": "10e6", "mirror": mirror, "counter": counter, **more}
            keys |= answered(simulated, **given).keys()
    assert keys <= HINTS.keys()
    assert HINTS.keys() - keys == {"shutter_pin"} - keys  # asked where the shutter is on the mirror's controller
    page = (Path(__file__).parents[2] / "docs/howto/my-bench.md").read_text().split("| key | answer |")[1]
    assert set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (.*?) \|", page, re.M)))) == HINTS.keys()


def test_a_wall_that_is_turned_and_no_square_is_written_and_seen_by_its_doctor(tmp_path: Path) -> None:
    file = tmp_path / "turned.yaml"
    given = ["wall_yaw_deg=20", "wall_pitch_deg=-5", "half_m=0.6", "half_height_m=0.4"]
    assert new("bench", file, None, given, True, True, False) == 0
    geometry = load("bench", str(file), BenchSettings).settings.geometry
    assert (geometry.wall_yaw_deg, geometry.wall_pitch_deg) == (20, -5)
    assert geometry.allowed is not None
    assert (geometry.allowed.left_m, geometry.allowed.right_m) == (-0.6, 0.6)
    assert (geometry.allowed.bottom_m, geometry.allowed.top_m) == (-0.4, 0.4)


@pytest.mark.parametrize("port", ["sim://triggerscope", "simulated"])
def test_a_simulated_port_of_a_real_bench_is_refused_at_that_question(
    port: str, at_a_terminal: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at_a_terminal(f"triggerscope\n{port}\n/dev/ttyACM7\n" + "\n" * 12 + "1.42" + "\n" * 8 + "20e6\n")
    said = answers(questions(NOTHING, False), {})
    assert said["port"] == "/dev/ttyACM7"
    assert f"{port!r} is a simulated instrument: `nlos new bench --simulated`" in capsys.readouterr().err
    with pytest.raises(UsageError, match=r"--answer port: .*--simulated"):
        answers(questions(NOTHING, False), {"mirror": "triggerscope", "port": port})


def test_a_port_of_a_simulated_bench_is_refused_before_the_first_question(
    at_a_terminal: Callable[[str], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UsageError, match=r"has no port. Leave it out, or leave out --simulated"):
        new("bench", tmp_path / "b.yaml", None, ["port=/dev/ttyACM0"], True, False, False)
    assert "mirror controller" not in capsys.readouterr().err


def test_a_failure_at_the_end_gives_the_answers_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Given again as they were printed, they make the file."""
    given = ["wall_distance_m=1.42", "scanner_x_m=-0.25"]
    with pytest.raises(UsageError, match=r"colour: no such question.*--answer scanner_x_m=-0.25"):
        new("bench", tmp_path / "b.yaml", None, [*given, "colour=red"], True, False, False)
    (tmp_path / "file").touch()
    monkeypatch.setattr("nlos.cli.new.check_writable", lambda folder: None)  # it was a folder then
    with pytest.raises(OSError, match="file"):
        new("bench", tmp_path / "file" / "b.yaml", None, given, True, False, False)
    options = shlex.split(capsys.readouterr().err.partition("to give again: ")[2])
    assert options[::2] == ["--answer"] * (len(options) // 2)
    assert set(given) < set(options[1::2])
    assert new("bench", tmp_path / "b.yaml", None, options[1::2], True, False, False) == 0


def test_a_port_is_named_by_what_tells_its_adapter_from_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Adapters without a serial number share one name in by-id, that of whichever was plugged in last."""
    monkeypatch.setattr(detection, "_SERIAL", tmp_path)
    for folder, name, port in (
        ("by-id", "usb-1a86_USB_Serial-if00-port0", "ttyUSB1"), ("by-id", "usb-FTDI_A5-if00-port0", "ttyUSB2"),
        ("by-path", "usb-0:1:1.0-port0", "ttyUSB0"), ("by-path", "usb-0:2:1.0-port0", "ttyUSB1"),
        ("by-path", "usb-0:3:1.0-port0", "ttyUSB2"),
    ):  # fmt: skip
        (tmp_path / port).touch()
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).symlink_to(tmp_path / port)
    ports = [PortInfo(str(tmp_path / f"ttyUSB{k}"), "", "A5" if k == 2 else "", 0x1A86) for k in range(3)]
    monkeypatch.setattr(detection, "available_ports", lambda: ports)
    found = detection.detect().ports
    assert [Path(each).name for each in found] == ["usb-0:1:1.0-port0", "usb-0:2:1.0-port0", "usb-FTDI_A5-if00-port0"]

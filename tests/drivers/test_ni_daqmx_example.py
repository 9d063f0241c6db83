"""The NI-DAQmx example of docs/howto/ni-daqmx: installed, scanned with on its own stand-in, and what it refuses.

What NI's own package makes of it is `tests/peers/test_ni_daqmx.py`.
"""

import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from tests.ni_daqmx_lab import BENCH, EXAMPLE, installed, nlos


class Package:
    """As much of nidaqmx as the example calls: one card; what is written is kept."""

    def __init__(self) -> None:
        self.written: list[Any] = []
        self.started = self.closed = 0
        self.system = self.System = self.ao_channels = self.do_channels = self
        self.devices, self.driver_version, self.ao_voltage_rngs = {"Dev1": self}, (24, 5, 0), [-10.0, 10.0]
        self.product_type, self.serial_num, self.is_simulated = "USB-6343", 0x1ABCDEF, True

    def local(self) -> "Package":
        return self

    Task = local

    def add_ao_voltage_chan(self, output: str, min_val: float, max_val: float) -> None:
        assert (min_val, max_val) == (-5.0, 5.0)

    def add_do_chan(self, lines: str) -> None:
        pass

    def start(self) -> None:
        self.started += 1

    def close(self) -> None:
        self.closed += 1

    def write(self, value: Any, auto_start: bool, timeout: float) -> int:
        self.written.append(value)
        return 1


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(EXAMPLE))
    import nlos_ni_daqmx

    return nlos_ni_daqmx


def test_it_is_scanned_with_asked_for_and_looked_for(tmp_path: Path) -> None:
    lab = installed(tmp_path)
    done = nlos(lab, "scan", "scan.yaml", "--bench", "bench.yaml", "-o", "run.h5")
    assert done.returncode == 0, done.stderr
    assert "no watchdog" in done.stderr
    answers = ("--answer=mirror=ni_daqmx", "--answer=volts_per_degree=0.8")
    done = nlos(lab, "new", "bench", "--simulated", "--no-check", *answers, "-o", "made.yaml")
    assert done.returncode == 0, done.stderr
    assert (lab / "made.yaml").read_text("utf-8").count("volts_per_degree: 0.8") == 2
    done = nlos(
        lab, "new", "bench", "--simulated", "--no-check", *answers, "--answer=counter=picoquant", "-o", "ttl.yaml"
    )
    assert (done.returncode, "--answer shutter_line=..." in done.stderr) == (2, True), done.stderr
    line = ("--answer=counter=picoquant", "--answer=shutter_line=Dev1/port0/line0")
    done = nlos(lab, "new", "bench", "--simulated", "--no-check", *answers, *line, "-o", "ttl.yaml")
    assert done.returncode == 0, done.stderr
    assert "shutter_line: Dev1/port0/line0" in (lab / "ttl.yaml").read_text("utf-8")
    real = BENCH.partition("simulation:")[0].replace("library: simulated", "library: vendor")
    (lab / "real.yaml").write_text(real, "utf-8")
    (lab / "site" / "nidaqmx.py").write_text("raise ImportError('it is not here')", "utf-8")
    done = nlos(lab, "devices", "--bench", "real.yaml")
    assert done.returncode == 3
    assert "MISSING  mirror ni_daqmx at vendor: look for cards: it is not here" in done.stdout
    assert "pip install nidaqmx" in done.stdout


def test_the_block_that_the_page_shows_is_valid(example: Any) -> None:
    (block,) = re.findall(r"^```yaml\n(.*?)^```", EXAMPLE.with_suffix(".md").read_text("utf-8"), re.M | re.S)
    settings = example.NiDaqmxSettings.model_validate(yaml.safe_load(block)["mirror"])
    assert settings.shutter_line is None


def test_what_is_beyond_angle_volts_or_the_rectangle_is_refused_and_nothing_is_written(example: Any) -> None:
    package = Package()
    keys = {"least_v": -5.0, "most_v": 5.0, "x": {"offset_v": 1.0}, "max_mechanical_deg": 9.0,
            "allowed_deg": {"bottom_deg": -3.0}, "shutter_line": "Dev1/port0/line0"}  # fmt: skip
    settings = example.NiDaqmxSettings.model_validate({"model": "ni_daqmx"} | keys)
    mirror = example.MIRROR.open(settings, VirtualClock(), package, None)
    assert package.written == [False, [1.0, 0.0]]  # dark, then centred
    assert any("only simulates" in each for each in mirror.warnings)
    for x_deg, y_deg, why in (
        (18.1, 0.0, "outside"),
        (17.0, 0.0, r"\+5\.250 V, outside -5 to 5 V"),
        (0.0, -3.1, "allowed_deg"),
        (math.nan, 0.0, "outside"),
    ):
        for act in (mirror.check, mirror.begin_move, mirror.move_to):
            with pytest.raises(LimitError, match=why):
                act(MirrorAngles(math.radians(x_deg), math.radians(y_deg)))
    assert len(package.written) == 2
    mirror.move_to(MirrorAngles(math.radians(-8.0), math.radians(4.0)))
    assert package.written[-1] == pytest.approx([-1.0, 1.0])
    mirror.park()
    mirror.close()
    assert package.written[-2:] == [[1.0, 0.0], False]
    assert (package.started, package.closed) == (2, 2)


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"y_output": "Dev1/ao0"}, "two outputs of one card"),
        ({"y_output": "Dev2/ao1"}, "two outputs of one card"),
        ({"x_output": "Dev1/ao0:1"}, "pattern"),
        ({"shutter_line": "Dev1/port0"}, "pattern"),
        ({"x": {"volts_per_degree": 0.0}}, "must not be 0"),
        ({"y": {"offset_v": 6.0}, "most_v": 5.0}, "offset_v must lie within"),
    ],
)
def test_a_bench_file_that_makes_no_sense_is_refused(example: Any, keys: dict[str, object], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        example.NiDaqmxSettings.model_validate({"model": "ni_daqmx"} | keys)

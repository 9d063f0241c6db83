"""The NI-DAQmx example by NI's own Python package, which calls a simulated card through the C interface."""

import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.drivers.clock import SystemClock
from nlos.drivers.errors import (
    DeviceBusy,
    DeviceError,
    DeviceFault,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LimitError,
)
from nlos.drivers.galvo.mirror import MirrorAngles
from tests.ni_daqmx_lab import EXAMPLE, installed, nlos
from tests.peers.ni_daqmx.c_library import Card, plugged_in

HERE = Path(__file__).parent
POINT = """
import os, sys
from dataclasses import replace
sys.path.append(os.environ["NI_PACKAGES"])  # last: all but NI's is the project's own
import nlos_ni_daqmx
from c_library import on_table
MIRROR = replace(nlos_ni_daqmx.MIRROR, firmware=on_table)
"""
KEYS = {"model": "ni_daqmx", "shutter_line": "Dev1/port0/line0", "timeout_s": 0.1}


@pytest.fixture(scope="session")
def packages(foreign_python: Callable[..., Path]) -> str:
    """Where NI's package is installed."""
    where = "import nidaqmx, pathlib; print(pathlib.Path(nidaqmx.__file__).parents[1])"
    return subprocess.run([foreign_python("nidaqmx"), "-c", where], capture_output=True, text=True).stdout.strip()


@pytest.fixture
def example(packages: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(EXAMPLE))
    sys.path.append(packages)
    import nlos_ni_daqmx

    yield nlos_ni_daqmx
    sys.path.remove(packages)


def opened(example: Any, card: Card, **keys: object) -> Any:
    settings = example.NiDaqmxSettings.model_validate(KEYS | keys)
    return example.MIRROR.open(settings, SystemClock(), plugged_in(card), None)


def deg(x: float, y: float) -> MirrorAngles:
    return MirrorAngles(math.radians(x), math.radians(y))


def volts(card: Card) -> list[float]:
    return [card.outputs["Dev1/ao0"], card.outputs["Dev1/ao1"]]


def test_a_whole_scan_puts_out_what_was_planned(packages: str, tmp_path: Path) -> None:
    lab = installed(tmp_path, "ni_peer:MIRROR")
    (lab / "site" / "ni_peer.py").write_text(POINT, "utf-8")
    (lab / "site" / "c_library.py").write_text((HERE / "ni_daqmx" / "c_library.py").read_text("utf-8"), "utf-8")
    done = nlos(lab, "scan", "scan.yaml", "--bench", "bench.yaml", "-o", "run.h5", NI_PACKAGES=packages)
    assert done.returncode == 0, done.stderr
    assert "Exception ignored" not in done.stderr
    written = [tuple(json.loads(line)) for line in (lab / "outputs.jsonl").read_text("utf-8").splitlines()]
    assert written[0] == (0.0, 0.0, False)  # dark before anything moves
    assert written[-1][2] is False
    assert written[-1][:2] == pytest.approx((0.0, 0.25), abs=1e-3)  # parked
    lit = [place for place, _ in groupby(each[:2] for each in written if each[2])]
    x_rad, y_rad = np.radians([(x / 0.4, (y - 0.25) / -0.25) for x, y in lit]).T  # by the bench file's volts per degree
    spots = 2.0 * np.stack([np.tan(x_rad) / np.cos(y_rad), np.tan(y_rad)], axis=1)  # at 2 m
    with h5py.File(lab / "run.h5") as run:
        planned = np.stack([run["plan/x_m"][:], run["plan/y_m"][:]], axis=1)
        assert '"USB-6343", "serial": "01ABCDEF", "firmware": "NI-DAQmx 24.5.0"' in run["header/devices"][()].decode()
    assert len(planned) == 16
    assert np.abs(spots - planned).max() < 3e-5  # half a step of 16 bits over 20 V is 0.02 mm there
    done = nlos(lab, "doctor", "--bench", "bench.yaml", NI_PACKAGES=packages)
    assert done.returncode == 0, done.stdout + done.stderr


def test_it_opens_dark_and_centred_holds_its_outputs_and_leaves_them_where_they_are(example: Any) -> None:
    seen: list[dict[str, Any]] = []
    card = Card(lambda outputs: seen.append(dict(outputs)))
    card.outputs |= {"Dev1/ao0": 7.0, "Dev1/port0/line0": True}  # as a killed program left them
    mirror = opened(example, card)
    assert seen[0]["Dev1/port0/line0"] is False
    assert seen[0]["Dev1/ao0"] == 7.0
    assert volts(card) == [0.0, 0.0]
    mirror.move_to(deg(8.0, -4.0))
    assert volts(card) == pytest.approx([2.0, -1.0], abs=2e-4)
    with pytest.raises(DeviceBusy, match=r"resource is reserved.*Close what holds it"):
        opened(example, card)
    mirror.set_shutter_line(True)
    assert card.outputs["Dev1/port0/line0"]
    mirror.close()
    mirror.close()
    assert not card.outputs["Dev1/port0/line0"]
    assert volts(card) == pytest.approx([2.0, -1.0], abs=2e-4)
    assert not card.held
    assert not card.tasks


@pytest.mark.parametrize(
    ("ranges", "keys", "kind", "says"),
    [
        ((0.0, 5.0), {}, LimitError, r"USB-6343 puts out 0 to 5 V, not -10 to 10 V\. Set `least_v`"),
        ((), {}, LimitError, "puts out no voltage"),
        (
            (-10.0, 10.0),
            {"x_output": "Dev2/ao0", "y_output": "Dev2/ao1"},
            DeviceNotFound,
            r"is invalid.*NI MAX",
        ),
        ((-10.0, 10.0), {"y_output": "Dev1/ao7"}, DeviceNotFound, "channel specified does not exist"),
        ((-10.0, 10.0), {"shutter_line": "Dev1/port0/line9"}, DeviceNotFound, "channel specified does not exist"),
    ],
)
def test_what_the_card_has_not_is_told_as_it_is_opened_and_nothing_stays_reserved(
    example: Any, ranges: tuple[float, ...], keys: dict[str, object], kind: type[DeviceError], says: str
) -> None:
    card = Card(lambda outputs: None, ranges)
    with pytest.raises(kind, match=says):
        opened(example, card, **keys)
    assert volts(card) == [0.0, 0.0]
    assert not card.tasks


def test_a_card_that_is_pulled_out_is_lost_and_moves_no_more(example: Any) -> None:
    card = Card(lambda outputs: None)
    mirror = opened(example, card)
    card.plugged = False
    with pytest.raises(DeviceLost, match=r"cannot be accessed.*Check cable"):
        mirror.move_to(deg(1.0, 1.0))
    card.plugged = True
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(deg(1.0, 1.0))
    mirror.park()
    mirror.close()


def test_a_call_that_never_returns_has_a_deadline_and_no_light_is_confirmed_off_behind_it(example: Any) -> None:
    card = Card(lambda outputs: None)
    mirror = opened(example, card)
    mirror.set_shutter_line(True)
    card.hangs = "ao0"
    with pytest.raises(DeviceTimeout, match=r"did not return within 0\.1 s from: write .* to its outputs"):
        mirror.move_to(deg(1.0, 1.0))
    for _ in range(2):
        with pytest.raises(DeviceTimeout, match="Shut the laser off"):
            mirror.set_shutter_line(False)
        assert not card.outputs["Dev1/port0/line0"]  # it went past what hangs
    with pytest.raises(DeviceTimeout, match="Shut the laser off"):
        mirror.park()
    card.hangs = "line0"
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.set_shutter_line(True)
    with pytest.raises(DeviceTimeout, match="to its line"):
        mirror.set_shutter_line(False)
    with pytest.raises(DeviceTimeout, match="to its line"):
        mirror.park()
    assert volts(card) == pytest.approx([0.25, 0.25], abs=2e-4)  # as the late one left them
    card.hangs = "nothing"
    mirror.set_shutter_line(False)
    mirror.close()
    assert not card.tasks

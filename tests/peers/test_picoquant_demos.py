"""PicoQuant's demo programs and header files: what they do with the stand-in for the libraries, and its numbers."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nlos.drivers.simulated.picoquant.error_texts import TEXTS
from nlos.drivers.tcspc.picoquant.families import FAMILIES

HERE = Path(__file__).parent
FOLDERS = {
    "multiharp150": "MH150-Demos/Windows/64bit", "hydraharp400": "HH400-v3.x-Demos/Windows/64bit",
    "picoharp300": "PH300-v3.x-Demos/64",
}  # fmt: skip
HEADERS = {
    "multiharp150": "C/histomode/mhdefin.h", "hydraharp400": "C/histomode/hhdefin.h",
    "picoharp300": "c/Standard/phdefin.h",
}  # fmt: skip
HISTOGRAMS = {
    "multiharp150": ("Python/histomode/histomode.py", "histomode.out"),
    "hydraharp400": ("Python/histomode.py", "histomodeout.txt"),
    "picoharp300": ("python/Standard/dlldemo.py", "dlldemo.out"),
}
EVENTS = {
    "multiharp150": ("Python/advanced/tttrmode_instant_processing/tttrmode.py", "tttrmodeout.txt", 80.0),
    "hydraharp400": ("Python/advanced/tttrmode_instant_processing/tttrmode.py", "tttrmodeout.txt", 1.0),
}
Checkout = Callable[..., Path]


@pytest.fixture(params=FOLDERS)
def device(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def ran(device: str, demo: Path, folder: Path) -> tuple[str, dict[str, np.ndarray]]:
    """What the demo said, and what went through the stand-in."""
    done = subprocess.run(
        [sys.executable, HERE / "picoquant" / "run_demo.py", device, demo],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1] / "src")},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Aborted" not in done.stdout
    with np.load(folder / "ours.npz") as ours:
        return done.stdout, dict(ours)


def test_a_demo_saves_the_histogram_that_the_instrument_counted(
    device: str, checkout: Checkout, tmp_path: Path
) -> None:
    demo, output = HISTOGRAMS[device]
    said, ours = ran(device, checkout(FOLDERS[device], demo), tmp_path)
    saved = [int(line) for line in (tmp_path / output).read_text().splitlines() if re.fullmatch(r" *\d+ *", line)]
    assert saved == ours["histogram"].tolist()
    assert sum(saved) == pytest.approx(40_000, rel=0.01)
    assert f"{sum(saved)}" in said
    assert "10000000" in said  # pulses a second


@pytest.mark.parametrize("device", EVENTS)
def test_a_demo_tells_pulses_and_delays_of_the_records_as_we_do(
    device: str, checkout: Checkout, tmp_path: Path
) -> None:
    demo, output, resolution_ps = EVENTS[device]
    _, ours = ran(device, checkout(FOLDERS[device], demo), tmp_path)
    lines = [line.split() for line in (tmp_path / output).read_text().splitlines() if line.startswith("CH")]
    assert len(lines) > 1_000
    assert {line[1] for line in lines} == {"1"}
    assert [round(float(line[3]) / resolution_ps) for line in lines] == ours["delays"].tolist()
    assert np.allclose([float(line[2]) for line in lines], ours["pulses"] / 10e6, atol=1e-8)


def test_a_demo_saves_the_records_that_the_instrument_handed_over(checkout: Checkout, tmp_path: Path) -> None:
    demo = checkout(FOLDERS["picoharp300"], "python/TTTRmode/tttrmode.py")
    said, ours = ran("picoharp300", demo, tmp_path)
    measured_ms = re.findall(r"AcquisitionTime +: (\d+)", said)
    assert np.fromfile(tmp_path / "tttrmode.out", "<u4").tolist() == ours["records"].tolist()
    assert len(ours["delays"]) == pytest.approx(40 * int(measured_ms[0]), rel=0.05)


def defined(header: Path) -> dict[str, int]:
    """NAME -> number of every `#define` of one."""
    found = re.findall(r"#define\s+(\w+)\s+(-?(?:0x[0-9A-Fa-f]+|\d+))\b", header.read_text(encoding="latin-1"))
    return {name: int(number, 0) for name, number in found}


def test_limits_and_flags_are_those_of_the_header_files(device: str, checkout: Checkout) -> None:
    family, header = FAMILIES[device], defined(checkout(FOLDERS[device], HEADERS[device]))
    flags = {
        "FLAG_FIFOFULL": family.fifo_full, "FLAG_OVERFLOW": family.overflow, "FLAG_SYNC_LOST": family.sync_lost,
        "FLAG_SYSERROR": family.system_error, "FLAG_CNTS_DROPPED": family.counts_dropped,
    }  # fmt: skip
    assert flags == {name: header.get(name, 0) for name in flags}
    low, high = ("DISCRMIN", "DISCRMAX") if family.constant_fraction else ("TRGLVLMIN", "TRGLVLMAX")
    assert family.levels_mv == (header[low], header[high])
    assert family.most_zero_cross_mv == header.get("ZCMAX", family.most_zero_cross_mv)
    assert family.sync_dividers[-1] == header["SYNCDIVMAX"]
    assert family.largest_offset == header["OFFSETMAX"]
    assert family.most_fifo_records == header["TTREADMAX"]
    assert family.most_binning_codes == header["BINSTEPSMAX"]
    assert family.longest_marker_holdoff_ns == header["HOLDOFFMAX"]
    assert (family.fixed_bins or 65_536) == header.get("HISTCHAN", header.get("MAXHISTLEN"))
    assert header["ACQTMAX"] == 360_000_000


def test_error_codes_are_those_of_the_header_files(device: str, checkout: Checkout) -> None:
    header = defined(checkout(FOLDERS[device], HEADERS[device]).with_name("errorcodes.h"))
    prefix = FAMILIES[device].prefix
    theirs = {code: name.removeprefix(f"{prefix}_") for name, code in header.items()}
    ours = {code: text for code, text in TEXTS.items() if (prefix, code) != ("HH", -11)}  # which it never says
    assert {code: theirs.get(code) for code in ours} == ours

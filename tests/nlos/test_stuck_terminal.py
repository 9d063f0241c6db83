"""A terminal that takes nothing more (Ctrl-S, a connection that hangs) holds up nothing while light is on."""

import os
import pty
from pathlib import Path

import pytest

from nlos.cli.outliving import OutlivingStream
from nlos.drivers.exit_paths import ExitPaths
from tests.acquisition.killed_scans import FORK
from tests.acquisition.witnessed_bench import bench_file, witnessed
from tests.nlos.by_hand.at_a_terminal import at_a_terminal

SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 128, cols: 128}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""


@pytest.mark.parametrize("opened", [pty.openpty, os.pipe])
def test_what_nobody_takes_is_dropped_in_the_light_and_what_somebody_takes_is_whole(opened: object) -> None:
    ours, theirs = opened()  # type: ignore[operator]
    whole = "".join(f"line {number}\n" for number in range(100))

    def write() -> None:
        stream = OutlivingStream(os.fdopen(theirs, "w"))
        with ExitPaths(lambda why: None, lambda: None, lambda: True):
            stream.write(whole)
            stream.flush()
            for _ in range(3000):  # more than any of them holds
                stream.write("x" * 99 + "\n")
                stream.flush()
        os._exit(0)

    child = FORK.Process(target=write)
    child.start()
    child.join(240)
    ended = child.exitcode
    child.kill()
    child.join()
    assert ended == 0
    assert os.read(ours, 512).decode().replace("\r", "").startswith(whole[:300])
    os.close(ours)
    os.close(theirs)


def test_a_scan_that_has_something_to_say_to_a_stopped_terminal_shuts_its_light(tmp_path: Path) -> None:
    """A counter that answers nothing three times is an error of the scan, told with -v from the first time on."""
    (tmp_path / "small.yaml").write_text(SCAN)
    path = bench_file(tmp_path, "S1, TTL shutter")
    faults = "simulation:\n  faults: [{name: U1, after_s: 20.0, times: 3}]\n"
    path.write_text(path.read_text().replace("simulation:\n", faults))
    with at_a_terminal(tmp_path, "scan", "small.yaml", "-v", "--bench", str(path), "-o", "run.h5") as child:
        child.wait_until(lambda: "shutter open" in witnessed(tmp_path), "light")
        child.press("\x13")  # Ctrl-S
        child.wait_until(lambda: witnessed(tmp_path)[-1] == "shutter closed", "dark", 60)
        child.press("\x11")  # Ctrl-Q
        assert child.ends() == 9

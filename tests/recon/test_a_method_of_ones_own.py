"""A method of one's own is a file, or a package's entry point; what is wrong with it is said with its file and line."""

import json
import os
import re
import signal
import subprocess
import sys
import types
from pathlib import Path
from typing import cast

import h5py
import numpy as np
import pytest

import nlos
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.cli.exit_codes import exit_code
from nlos.configs.load import find as find_file
from nlos.recon.errors import InvalidSettings, ReconError, ReconstructionFailed
from nlos.recon.evaluate import evaluate
from nlos.recon.live import LiveReconstruction
from nlos.recon.method import Method
from nlos.recon.methods import catalogue, find, parse_settings, usable
from nlos.recon.own_methods import with_its_line
from nlos.recon.reconstruct import reconstruct
from tests.command import nlos as command_nlos

EXAMPLE = Path(__file__).with_name("method_of_ones_own.py")
PAGE = Path(__file__).parents[2] / "docs" / "howto" / "methods.md"
TEXT = EXAMPLE.read_text(encoding="utf-8")
WALL, TIME = WallGrid(1.0, 0.5, 4, 8), TimeAxis(32, 100e-12)
MAKES = "return MethodResult(brightest.values, depth_m.where(brightest.values >= self.least, torch.nan))"


@pytest.fixture
def scan() -> Transient:
    counts = np.zeros((32, 4, 8), np.float32)
    counts[20, 1, 5] = 9
    return Transient(counts, np.ones((4, 8)), WALL, TIME)


def test_the_example_is_short_and_is_what_the_page_shows() -> None:
    assert len([line for line in TEXT.splitlines() if line.strip()]) <= 30
    assert f"<<'END'\n{TEXT}END\n" in PAGE.read_text(encoding="utf-8")


def test_a_file_with_settings_and_build_is_a_method(scan: Transient) -> None:
    seen = reconstruct(scan, str(EXAMPLE), {"least_counts": 2})
    assert seen.albedo[1, 5] == 9
    assert seen.depth_m[1, 5] == pytest.approx(20.5 * 100e-12 * 299_792_458 / 2)
    assert np.isnan(seen.depth_m).sum() == 31
    assert seen.volume is None
    assert (seen.method, seen.settings) == ("method_of_ones_own.py", {"least_counts": 2})
    assert parse_settings(str(EXAMPLE), {}).model_dump() == {"least_counts": 1.0}
    assert "method_of_ones_own" not in catalogue()
    live = LiveReconstruction(str(EXAMPLE)).update(scan, 32)
    np.testing.assert_array_equal(live.reconstruction.albedo, seen.albedo)


def test_python_takes_it_and_sees_the_file_as_it_is_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    histograms = np.random.default_rng(0).poisson(1.0, (4, 8, 32))
    Path("mine.py").write_text(TEXT, encoding="utf-8")
    before = nlos.reconstruct(histograms, "mine.py", wall=1.0, bin_width=1e-10)
    Path("mine.py").write_text(TEXT.replace("MethodResult(brightest.values,", "MethodResult(2 * brightest.values,"))
    after = nlos.reconstruct(histograms, "./mine.py", wall=1.0, bin_width=1e-10)
    np.testing.assert_array_equal(after.albedo, 2 * before.albedo)


def test_it_is_judged_beside_ours_under_a_name_of_its_own(tmp_path: Path) -> None:
    counts = np.random.default_rng(0).poisson(1.0, (8, 8, 32))
    with h5py.File(tmp_path / "scene.h5", "w") as file:
        file.attrs.update({"bin_width_s": 1e-10, "wall_size_m": 1.0})
        file["transient"] = counts
        file["gt_intensity"], file["gt_depth"], file["gt_mask"] = counts[..., 20], np.full((8, 8), 0.3), np.ones((8, 8))
    words = ["lct", str(EXAMPLE), f"mine={EXAMPLE}"]
    done = evaluate([tmp_path], words, ["transient"], fixed=True, say=lambda line: None)
    assert [row.method for row in done.rows] == ["lct", EXAMPLE.name, "mine"]
    assert done.rows[1].psnr == done.rows[2].psnr


WRONG = {
    "no file": (None, 2, r"mine\.py cannot be read: No such file"),
    "nothing in it": ("", 2, "there is no class Settings and no function build"),
    "no build": (TEXT.replace("def build(", "def make("), 2, "there is no function build"),
    "not Python": (TEXT + "\nthis is (\n", 2, r"mine\.py:33: "),
    "raises when it is run": (TEXT + "\n1 / 0\n", 2, r"mine\.py:33: ZeroDivisionError"),
    "ends the program": (TEXT + "\nraise SystemExit(0)\n", 2, r"mine\.py:33: SystemExit"),
    "needs what is not there": ("import no_such_package\n" + TEXT, 2, r"mine\.py:1: ModuleNotFoundError: .*no_such"),
    "settings of another kind": (TEXT.replace("class Settings(AnySettings)", "class Settings"), 2, r":12: .*derive"),
    "build of two": (TEXT.replace("wall: WallGrid, time: TimeAxis) ->", "wall: WallGrid) ->"), 2, r":30: build must"),
    "build raises": (TEXT.replace("return BrightestReturn", "1 / 0; return BrightestReturn"), 8, r":31: ZeroDivision"),
    "build returns a word": (
        TEXT.replace("return BrightestReturn(settings, time)", "return 'x'"),
        8,
        r":30: .* str, no",
    ),
    "raises on a scan": (TEXT.replace("counts[:, 0].max(", "counts[:, 0].maxx("), 8, r":25: AttributeError"),
    "an import inside": (
        TEXT.replace("brightest = counts", "import no_such; brightest = counts"),
        8,
        r":25: ModuleNot",
    ),
    "returns a tensor": (TEXT.replace(MAKES, "return brightest.values"), 8, r":24: returned Tensor, not a MethodRe"),
    "another shape": (
        TEXT.replace("MethodResult(brightest.values,", "MethodResult(brightest.values[0],"),
        8,
        r":24: albedo is \(4, 8\), must be \(1, 4, 8\)",
    ),
    "another type": (TEXT.replace("(brightest.values,", "(brightest.indices,"), 8, r":24: albedo is torch.int64, must"),
    "an array": (TEXT.replace("(brightest.values,", "(brightest.values.numpy(),"), 8, r":24: albedo is ndarray, must"),
    "NaN": (TEXT.replace("(brightest.values,", "(brightest.values / 0,"), 8, r":24: 32 of 32 values of albedo are not"),
    "below 0": (TEXT.replace("(brightest.values,", "(-brightest.values,"), 8, r":24: albedo goes down to -9"),
    "depths behind it": (
        TEXT.replace("values, depth_m.", "values, -depth_m."),
        8,
        r":24: depth_m goes down to -0\.3.* m",
    ),
    "ends on a scan": (
        TEXT.replace("brightest = counts", "raise SystemExit(0); brightest = counts"),
        8,
        ":25: SystemExit",
    ),
    "ends the program on the spot": (TEXT + "\nimport os\nos._exit(0)\n", 2, r"mine\.py:34: RuntimeError: os\._exit"),
    "ends the program on a scan": (
        TEXT.replace("brightest = counts", "import os; os._exit(3); brightest = counts"),
        8,
        r":25: RuntimeError: os\._exit\(3\) would have ended the whole program",
    ),
    "raises what is no Exception": (
        TEXT.replace("brightest = counts", "raise type('Odd', (BaseException,), {})('odd'); brightest = counts"),
        8,
        r":25: Odd: odd",
    ),
    "cannot say what it raises": (
        TEXT.replace("brightest =", "raise type('E', (Exception,), {'__str__': lambda self: 1 / 0})(); brightest ="),
        8,
        r":25: E\.",
    ),
    "a part of torch that is not there": (
        TEXT.replace("brightest = counts", "import torch.no_such; brightest = counts"),
        8,
        r":25: ModuleNotFoundError",
    ),
    "settings that raise": (
        TEXT.replace(
            "least_counts: float = 1.0", "least_counts: float = 1.0\n\n    def model_post_init(self, _):\n        1 / 0"
        ),
        2,
        r":18: ZeroDivisionError",
    ),
    "a setting that no file can keep": (
        TEXT.replace("least_counts: float = 1.0", "least_counts: object = object()"),
        2,
        r":12: PydanticSerializationError",
    ),
    "millimetres": (
        TEXT.replace("values, depth_m.", "values, 1e3 * depth_m."),
        8,
        r":24: depth_m goes up to 307 m, .* at most 0\.495 m; depths are in metres",
    ),
    "intervals of other names": (
        TEXT.replace(MAKES, f"return sure({MAKES.removeprefix('return ')}, {{'low': depth_m}})").replace(
            "import MethodResult", "import MethodResult, sure"
        ),
        8,
        r":24: intervals are low, must be albedo_low,",
    ),
    "sure of more than all": (
        TEXT.replace(MAKES, f"return sure({MAKES.removeprefix('return ')}, dict.fromkeys(INTERVALS, 2 + 0 * depth_m))")
        .replace("import MethodResult", "import MethodResult, sure")
        .replace("import torch\n", "import torch\nfrom nlos.recon.contract import INTERVALS\n", 1),
        8,
        r":25: seen is a probability",
    ),
    "depths that are words": (
        TEXT.replace("self.least, self.depths_m = ", "self.depths_m = 'near'; self.least, self.planes = ").replace(
            "self.depths_m)", "self.planes)"
        ),
        8,
        r"depths_m is 'near', must be",
    ),
    "planes from far to near": (
        TEXT.replace("torch.nan))", "torch.nan), counts[:, 0])").replace(
            "        return MethodResult", "        self.depths_m = self.depths_m[::-1]\n        return MethodResult"
        ),
        8,
        r":24: depths_m of shape \(32,\) must be .* each behind the last",
    ),
    "no depths": (
        TEXT.replace("self.least, self.depths_m = ", "self.least, self.planes = ")
        .replace("self.depths_m)", "self.planes)")
        .replace("torch.nan))", "torch.nan), counts[:, 0])"),
        8,
        r"volume is \(1, 32, 4, 8\), must be \(1, 0, 4, 8\) .*`depths_m`",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_file_is_said_with_its_line(case: str, scan: Transient, tmp_path: Path) -> None:
    text, code, words = WRONG[case]
    if text is not None:
        assert text != TEXT, "nothing is wrong with it"
        (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(ReconError, match=words) as raised:
        reconstruct(scan, str(tmp_path / "mine.py"))
    assert exit_code(raised.value) == code
    assert case == "no file" or "mine.py" in str(raised.value)


def test_what_it_writes_into_its_counts_is_not_written_into_the_scan(scan: Transient, tmp_path: Path) -> None:
    wild = TEXT.replace(MAKES, f"counts.zero_()\n        exposure_s.zero_()\n        {MAKES}")
    (tmp_path / "mine.py").write_text(wild, encoding="utf-8")
    assert reconstruct(scan, str(tmp_path / "mine.py")).albedo[1, 5] == 9
    assert (scan.counts.sum(), scan.exposure_s.min()) == (9, 1)


def test_a_signal_that_falls_into_it_ends_the_program(tmp_path: Path) -> None:
    module = types.ModuleType("mine")
    module.__file__ = str(tmp_path / "mine.py")
    with pytest.raises(SystemExit), with_its_line("mine.py", cast(Method, module)):
        exec("raise SystemExit(143)", {"__name__": "nlos.cli.interrupts"})  # where the handler is


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is forked")
def test_what_it_forks_ends_as_it_likes_and_so_does_the_program_afterwards(scan: Transient, tmp_path: Path) -> None:
    end = os._exit
    forks = "child = os.fork(); child or os._exit(7); assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7"
    text = TEXT.replace("brightest = counts", f"import os; {forks}; brightest = counts")
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    assert reconstruct(scan, str(tmp_path / "mine.py")).albedo[1, 5] == 9
    assert os._exit is end


def test_who_imported_the_end_within_it_can_end_the_program_afterwards(tmp_path: Path) -> None:
    (tmp_path / "ends.py").write_text("from os import _exit\n\n\ndef end():\n    _exit(42)\n", encoding="utf-8")
    code = "from nlos.recon.put_back import put_back\nwith put_back('mine'):\n    import ends\nends.end()\n"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (42, "")


def test_a_watchdog_that_finds_it_hanging_ends_the_program(tmp_path: Path) -> None:
    (tmp_path / "watchdog.py").write_text(
        "import os\n\n\ndef bark(event):\n    event.wait()\n    os._exit(42)\n", encoding="utf-8"
    )
    code = (
        "import threading, time, watchdog\n"
        "from nlos.recon.put_back import put_back\n"
        "hangs = threading.Event()\n"
        "threading.Thread(target=watchdog.bark, args=[hangs], daemon=True).start()\n"
        "with put_back('mine'):\n"
        "    hangs.set()\n"
        "    time.sleep(20)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (42, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows tells of a crash in another way")
def test_a_crash_of_its_library_names_its_line_and_leaves_a_whole_recording_in_the_dark(tmp_path: Path) -> None:
    assert MAKES in TEXT
    (tmp_path / "crash.py").write_text(TEXT.replace(MAKES, "__import__('ctypes').string_at(0)"), encoding="utf-8")
    bench = find_file("bench", "simulated").read_text()
    (tmp_path / "bench.yaml").write_text(bench.replace("simulation:\n", "simulation:\n  witness: witness.txt\n"))
    words = ["scan", "five_by_five", "--bench", "bench.yaml", "-o", "run.h5", "--reconstruct", "./crash.py"]
    done = subprocess.run(
        [sys.executable, "-m", "nlos", *words], cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == -signal.SIGSEGV
    assert re.search(r'crash.py", line \d+ in forward', done.stderr), done.stderr
    light = re.findall("shutter (.*)", (tmp_path / "witness.txt").read_text())
    assert light == ["open", "closed"]
    command_nlos(tmp_path, "verify", "run.h5", check=True)


def test_what_lies_beside_it_cannot_end_the_command_either(scan: Transient, tmp_path: Path) -> None:
    (tmp_path / "beside_mine.py").write_text("import sys\n\n\ndef give_up():\n    sys.exit(0)\n", encoding="utf-8")
    text = TEXT.replace("brightest = counts", "import beside_mine; beside_mine.give_up(); brightest = counts")
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    with pytest.raises(ReconstructionFailed, match=r"beside_mine\.py:5: SystemExit: 0"):
        reconstruct(scan, str(tmp_path / "mine.py"))


def test_it_may_go_down_gradients_have_lists_for_settings_and_answer_in_bfloat16(
    scan: Transient, tmp_path: Path
) -> None:
    text = TEXT.replace("least_counts: float = 1.0", "least_counts: float = 1.0\n    names: list[str] = ['a']").replace(
        "        brightest = counts",
        "        tried = torch.zeros_like(counts).requires_grad_()\n"
        "        with torch.enable_grad():\n"
        "            ((tried - counts) ** 2).sum().backward()\n"
        "        counts = -tried.grad / 2\n"
        "        brightest = counts",
    )
    assert text.count("MethodResult(brightest.values,") == 1
    text = text.replace("MethodResult(brightest.values,", "MethodResult(brightest.values.bfloat16(),")
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    seen = reconstruct(scan, str(tmp_path / "mine.py"), {"names": ["b", "c"]})
    assert (seen.albedo[1, 5], seen.settings["names"]) == (9, ["b", "c"])


def test_what_it_prints_is_no_part_of_the_json_document(tmp_path: Path) -> None:
    loud = TEXT.replace("brightest = counts", "print('loud'); brightest = counts")
    (tmp_path / "mine.py").write_text(loud.replace("import torch\n", "import torch\n\nprint('louder')\n", 1), "utf-8")
    np.savez(tmp_path / "scan.npz", histograms=np.ones((4, 4, 32)), bin_width_s=1e-10, wall_size_m=1.0, rectified=True)
    words = ("reconstruct", "scan.npz", "--method", "./mine.py", "-o", "out", "--json")
    done = command_nlos(tmp_path, *words, check=True)
    assert json.loads(done.stdout)["reconstructions"][0]["folder"] == "out"
    assert {"loud", "louder"} <= set(done.stderr.split())


def test_a_wrong_setting_of_it_is_named() -> None:
    with pytest.raises(ReconError, match="no setting 'least_count'; did you mean 'least_counts'"):
        parse_settings(str(EXAMPLE), {"least_count": 1})


def test_a_package_brings_its_own(scan: Transient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pip would install it; a method of a name that is taken is skipped, one that cannot be loaded is said so."""
    (tmp_path / "acme_deep.py").write_text(TEXT, encoding="utf-8")
    (tmp_path / "acme_torn.py").write_text("1 / 0\n", encoding="utf-8")
    about = tmp_path / "acme-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\nSummary: Bright.\n", "utf-8")
    points = (
        "[nlos.methods]\nbrightest = acme_deep\nlct = acme_deep\ntorn = acme_torn\ngone = acme_gone\nx.py = acme_deep\n"
    )
    (about / "entry_points.txt").write_text(points, "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    said: list[str] = []
    monkeypatch.setattr("nlos.recon.own_methods._log.warning", lambda form, *words: said.append(form % words))
    assert catalogue()["brightest"] == "Bright. (package acme)"
    assert find("lct").__name__ == "nlos.recon.methods.lct"  # type: ignore[attr-defined]
    assert reconstruct(scan, "brightest").albedo[1, 5] == 9
    assert {"brightest", "torn", "gone"} - set(usable()) == {"torn", "gone"}
    assert said == [
        "the method lct of acme is skipped: the name is taken",
        "the method x.py of acme is skipped: a name that ends in .py is a file's",
    ]
    with pytest.raises(ReconError, match=r"^the method gone of the package acme: ModuleNotFoundError: .*'acme_gone'"):
        find("gone")
    with pytest.raises(ReconError, match=r"acme_torn\.py:1: ZeroDivisionError"):
        find("torn")
    for name in [name for name in sys.modules if re.match("acme_(deep|torn)", name)]:
        del sys.modules[name]


def test_a_file_that_does_not_say_what_it_is_and_an_untyped_setting_are_told_without_an_address(tmp_path: Path) -> None:
    silent = tmp_path / "silent.py"
    silent.write_text("\n".join(TEXT.split("\n")[1:]), encoding="utf-8")
    assert TEXT.startswith('"""')
    with pytest.raises(InvalidSettings, match=r"silent\.py:1: the file does not say what it is"):
        find(str(silent))
    untyped = tmp_path / "untyped.py"
    untyped.write_text(
        '"""Nothing."""\nfrom nlos.configs.settings import Settings as Base\n\nclass Settings(Base):\n    power = 2\n',
        encoding="utf-8",
    )
    with pytest.raises(InvalidSettings, match=r"untyped\.py:4: ") as refused:
        find(str(untyped))
    assert "http" not in str(refused.value)


def test_a_file_says_what_it_is_where_python_drops_docstrings(tmp_path: Path) -> None:
    bare = tmp_path / "bare.py"
    bare.write_text(f"{TEXT}\n__doc__ = None  # as `python -OO` leaves it\n", encoding="utf-8")
    assert find(str(bare)).build is not None

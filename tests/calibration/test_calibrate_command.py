"""`nlos calibrate`, from recordings of the simulated bench and from a plain file."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.__main__ import run as nlos
from nlos.acquisition.errors import StorageError
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import arrays_of_import
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.calibration.constants import load
from nlos.calibration.geometry import ScannerGeometry
from nlos.cli.terminal import terminal
from nlos.configs.load import load as load_settings
from nlos.drivers.bench import BenchSettings, open_bench
from tests.calibration.conftest import make_raw_scan

SCAN = """wall: {width_m: 1.0, height_m: 1.0, rows: 12, cols: 12}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording `run.h5`, one with the shutter closed, `dark.h5`, and a plain file, `plain.h5`."""
    path = tmp_path_factory.mktemp("calibrate")
    (path / "scan.yaml").write_text(SCAN)
    plan = load_settings("scan", str(path / "scan.yaml"), ScanSettings).settings.plan()
    lit = load_settings("bench", "zero_latency", BenchSettings).settings
    assert lit.simulation is not None
    unlit = lit.simulation.scene.model_copy(update={"direct_cps": 0.0, "hidden_cps": 0.0})
    dark = lit.model_copy(update={"simulation": lit.simulation.model_copy(update={"scene": unlit})})
    for name, settings in (("run.h5", lit), ("dark.h5", dark)):
        with open_bench(settings) as bench:
            devices = {"mirror": bench.mirror.identity, "counter": bench.counter.identity}
            header = Header(bench_json=settings.model_dump_json(), devices=devices)
            with RecordingWriter.create(path / name, plan, header) as writer:
                record(scan(plan, bench), writer)
    with h5py.File(path / "plain.h5", "w") as file:
        plain = make_raw_scan()
        file["histograms"] = plain.counts.reshape(16, 16, -1)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"], file.attrs["rectified"] = plain.bin_width_s, 2.0, False
    return path


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, dict[str, object]]:
    """Exit code and JSON document of `nlos calibrate`."""
    terminal.document.clear()
    code = nlos(["calibrate", *map(str, arguments), "--json"])
    terminal.as_json = False
    return code, json.loads(capsys.readouterr().out)


def test_constants_pictures_and_residuals_come_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = called(capsys, folder / "run.h5", folder / "dark.h5", "-o", folder / "c.h5")
    assert code == 0, told
    assert told["offset_rms_bins"] < 0.5  # type: ignore[operator]
    assert told["offset_rms_mm"] == pytest.approx(told["offset_rms_ps"] * 0.299792458 / 2)  # type: ignore[operator]
    assert told["wall_distance_m"] == pytest.approx(2.0, abs=0.02)
    assert abs(told["electronic_delay_ns"] - 0.35) < 4 * told["electronic_delay_error_ns"]  # type: ignore[operator]
    assert told["dark_hz"] > 0  # type: ignore[operator]
    names = {Path(str(picture)).name for picture in told["pictures"]}  # type: ignore[attr-defined]
    assert names == {"time_offset.png", "background.png", "direct_light.png", "wall.png"}
    constants = load(folder / "c.h5")
    assert constants.devices["counter"] == "tcspc488 SIM0001"
    assert constants.geometry is not None
    assert len(constants.sources) == 2


def test_nothing_is_overwritten_unasked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine.h5").write_text("mine")
    assert called(capsys, folder / "plain.h5", "-o", folder / "mine.h5")[0] == 6
    assert (folder / "mine.h5").read_text() == "mine"


def test_pictures_of_others_are_not_replaced_and_own_ones_are(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "c.h5"
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "background.png").write_text("mine")
    code, told = called(capsys, folder / "plain.h5", "-o", target)
    assert (code, "c/background.png: exists" in told["error"]["message"]) == (6, True)  # type: ignore[index]
    assert [path.name for path in (tmp_path / "c").iterdir()] == ["background.png"]
    assert not target.exists()
    assert called(capsys, folder / "plain.h5", "-o", target, "--overwrite")[0] == 0
    assert (tmp_path / "c" / "background.png").read_bytes()[1:4] == b"PNG"
    target.unlink()
    assert called(capsys, folder / "plain.h5", "-o", target)[0] == 0
    (tmp_path / "c" / "wall.png").unlink(missing_ok=True)
    (tmp_path / "c" / "wall.png").mkdir()
    before = target.read_bytes()
    code, told = called(capsys, folder / "plain.h5", "-o", target, "--overwrite")
    assert "c/wall.png: is a folder, where a picture would go" in told["error"]["message"]  # type: ignore[index]
    assert (code, target.read_bytes() == before) == (6, True)


def test_no_picture_of_an_earlier_measurement_is_left_beside_constants(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(capsys, folder / "plain.h5", "-o", tmp_path / "c.h5")[0] == 0
    drawn = sorted(path.name for path in (tmp_path / "c").iterdir())
    (tmp_path / "c" / "spots.png").write_bytes((tmp_path / "c" / "background.png").read_bytes())
    (tmp_path / "c" / "note.png").write_text("mine")
    assert called(capsys, folder / "plain.h5", "-o", tmp_path / "c.h5", "--overwrite")[0] == 0
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == sorted([*drawn, "note.png"])


def test_constants_that_the_disk_does_not_take_leave_no_pictures_either(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*words: object) -> None:
        raise StorageError("c.h5: cannot be written")

    monkeypatch.setattr("nlos.cli.calibrate.save", full)
    code, _ = called(capsys, folder / "plain.h5", "-o", tmp_path / "c.h5")
    assert code == 6
    assert not list(tmp_path.iterdir())


def test_constants_without_a_suffix_have_their_pictures_beside_them(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, told = called(capsys, folder / "plain.h5", "-o", tmp_path / "lab")
    assert code == 0, told
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lab", "lab-pictures"]
    code, told = called(capsys, folder / "plain.h5", "-o", tmp_path / "lab.h5")
    assert "lab: is a file, where a folder of pictures would go" in told["error"]["message"]  # type: ignore[index]
    assert code == 6


def test_a_plain_raw_file_is_calibrated_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = called(capsys, folder / "plain.h5", "-o", folder / "p.h5", "--dead-time-ns", "77")
    assert code == 0, told
    assert told["scanner_position_m"] == pytest.approx([0.1, -0.2, 2.0], abs=0.02)


@pytest.mark.parametrize("recorded", [False, True])
def test_a_raw_file_that_does_not_say_so_is_calibrated_with_raw(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], recorded: bool
) -> None:
    with h5py.File(folder / "plain.h5") as plain, h5py.File(tmp_path / "silent.h5", "w") as file:
        file["histograms"] = plain["histograms"][:]
        file.attrs.update({name: plain.attrs[name] for name in ("bin_width_s", "wall_size_m")})
    if recorded:
        assert nlos(["import", str(tmp_path / "silent.h5"), "-o", str(tmp_path / "run.h5")]) == 0
        capsys.readouterr()
    path = tmp_path / ("run.h5" if recorded else "silent.h5")
    code, told = called(capsys, path, "-o", tmp_path / "c.h5")
    assert code == 7
    assert "--raw" in told["error"]["message"]  # type: ignore[index]
    code, told = called(capsys, path, "--raw", "-o", tmp_path / "c.h5")
    assert code == 0, told
    assert told["scanner_position_m"] == pytest.approx([0.1, -0.2, 2.0], abs=0.02)


def test_spots_tell_the_mirrors_gains(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    angles = np.linspace(-12, 12, 5)
    x_deg, y_deg = (a.ravel() for a in np.meshgrid(angles, angles))
    true = ScannerGeometry(2.0, x_gain=1.0)
    x_m, y_m, _ = true.spots(np.deg2rad(x_deg), np.deg2rad(y_deg))
    rows = [f"{a},{b},{x:.4f},{y:.4f}" for a, b, x, y in zip(x_deg, y_deg, x_m, y_m, strict=True)]
    (tmp_path / "spots.csv").write_text("\n".join(["x_deg,y_deg,x_m,y_m", *rows]))
    code, told = called(capsys, folder / "run.h5", "-o", tmp_path / "c.h5", "--spots", tmp_path / "spots.csv")
    assert code == 0, told
    assert told["geometry"]["x_gain"] == pytest.approx(1.0, abs=0.01)  # type: ignore[index]
    assert told["spots_rms_mm"] < 0.1  # type: ignore[operator]
    (tmp_path / "spots.csv").write_text("x_deg,y_deg,x_m,y_m\n1,2,3,far\n")
    code, told = called(capsys, folder / "run.h5", "-o", tmp_path / "d.h5", "--spots", tmp_path / "spots.csv")
    assert code == 7
    assert "spots.csv:2" in told["error"]["message"]  # type: ignore[index]


def test_a_dark_run_alone_tells_the_dark_rate_if_it_was_meant_to_be_dark(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, told = called(capsys, folder / "dark.h5", "-o", folder / "d.h5")
    assert code == 7
    assert "Was the shutter closed?" in told["error"]["message"]  # type: ignore[index]
    assert not (folder / "d.h5").exists()
    code, told = called(capsys, folder / "dark.h5", "--dark", "-o", folder / "d.h5")
    assert code == 0, told
    assert abs(told["dark_hz"] - 600) < 4 * told["dark_hz_error"]  # type: ignore[operator]
    assert told["pictures"] == []


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        ("nan", r"row 1, column 5, bin 7 is not a number"),
        ("negative", r"row 1, column 5, bin 7 is negative"),
        ("saturated", r"point 21 at .* bin 7 holds 65535"),
        ("clipped", r"point 0 at .* all hold 40 counts, the most in the whole scan"),
        ("rectified", "is rectified already"),
        ("scattered", r"nothing was saved: direct arrivals scatter by .* most at point \d+"),
        ("late", r"point \d+ at .* direct light arrives in bin .* Lengthen the histogram"),
    ],
)
def test_bad_input_is_refused_by_point_and_reason(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], harm: str, reason: str
) -> None:
    with h5py.File(folder / "plain.h5") as file:
        counts, attributes = file["histograms"][:].astype(np.float32), dict(file.attrs)
    if harm == "scattered":
        shifts = np.random.default_rng(0).integers(-3, 4, (16, 16))
        counts = np.array([[np.roll(counts[r, c], shifts[r, c]) for c in range(16)] for r in range(16)])
    if harm == "clipped":
        counts = np.minimum(counts, 40)
    if harm == "late":
        counts = np.pad(counts, ((0, 0), (0, 0), (420, 0)))[..., :512]
    counts[1, 5, 7] = {"nan": np.nan, "negative": -1, "saturated": 65535}.get(harm, counts[1, 5, 7])
    with h5py.File(tmp_path / "bad.h5", "w") as file:
        file["histograms"] = counts
        file.attrs.update(attributes | {"rectified": harm == "rectified"})
    code, told = called(capsys, tmp_path / "bad.h5", "-o", tmp_path / "c.h5")
    assert code == 7
    assert re.search(reason, told["error"]["message"]), told  # type: ignore[index,call-overload]
    assert not (tmp_path / "c.h5").exists()


def test_a_file_without_a_wall_size_is_calibrated_on_the_wall_that_its_times_tell(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scan = read_any(folder / "plain.h5")
    write_ptu(arrays_of_import(scan, folder / "plain.h5"), tmp_path / "scan.ptu")
    code, told = called(capsys, tmp_path / "scan.ptu", "-o", tmp_path / "c.h5")
    assert code == 0, told
    assert told["wall_size_m"] == pytest.approx(2.0, abs=4 * told["wall_size_error_m"])  # type: ignore[operator]
    code, told = called(capsys, tmp_path / "scan.ptu", "--wall-size-m", "2", "-o", tmp_path / "d.h5")
    assert code == 0, told
    assert told["scanner_position_m"] == pytest.approx([0.1, -0.2, 2.0], abs=0.02)


def write_spots(path: Path, change: dict[int, str] | None = None, factor: float = 1.0) -> Path:
    """25 spots of the table that `run.h5` was taken on, to the millimetre; `change`: line -> what stands there."""
    x_deg, y_deg = (a.ravel() for a in np.meshgrid(*[np.linspace(-12, 12, 5)] * 2))
    x_m, y_m, _ = ScannerGeometry(2.0).spots(np.deg2rad(x_deg), np.deg2rad(y_deg))
    rows = ["x_deg,y_deg,x_m,y_m"]
    rows += [f"{a},{b},{x:.3f},{y:.3f}" for a, b, x, y in zip(x_deg, y_deg, x_m * factor, y_m * factor, strict=True)]
    for line, text in (change or {}).items():
        rows[line - 1] = text
    path.write_text("\n".join(rows) + "\n")
    return path


def test_a_mistyped_spot_is_named_by_its_line_and_other_units_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_spots(tmp_path / "spots.csv", {7: "-6,-6,-0.21,2.11"})
    for arguments in ((folder / "run.h5", "-o", tmp_path / "c.h5"), ()):
        code, told = called(capsys, *arguments, "--spots", table)
        assert code == 0, told
        (said,) = told["warnings"]  # type: ignore[misc]
        assert re.search(r"spots\.csv:7: excluded, .* mm in x and \+23\d\d mm in y", str(said))
        assert told["geometry"]["wall_distance_m"] == pytest.approx(2.0, abs=3e-3)  # type: ignore[index]
    code, told = called(
        capsys, folder / "run.h5", "-o", tmp_path / "d.h5", "--spots", write_spots(tmp_path / "mm.csv", factor=1000.0)
    )
    assert code == 7
    assert "Are these millimetres?" in told["error"]["message"]  # type: ignore[index]
    assert not (tmp_path / "d.h5").exists()


def test_what_the_spots_alone_tell_is_kept_apart_from_what_direct_light_tells(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_spots(tmp_path / "spots.csv")
    assert nlos(["calibrate", "--spots", str(table)]) == 0
    assert "told by the spots alone, for mirrors that turn by as much as they are told" in capsys.readouterr().out
    assert nlos(["calibrate", str(folder / "run.h5"), "-o", str(tmp_path / "c.h5"), "--spots", str(table)]) == 0
    said = capsys.readouterr().out
    (line,) = (each for each in said.splitlines() if each.startswith("told by the spots alone: scanner "))
    away = r"wall (1999|200\d)\.?\d* \+- [\d.]+ mm away"
    assert re.search(rf"{away}; by the direct times alone: {away}", line), line
    assert line.endswith("by both together: the lines above, with gains, offsets and delay")


def test_a_coarser_ruler_makes_larger_errors(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = write_spots(tmp_path / "spots.csv")
    fine, coarse = (called(capsys, "--spots", table, "--ruler-mm", each)[1]["geometry_errors"] for each in ("1", "2"))
    assert coarse["scanner_x_m"] == pytest.approx(2 * fine["scanner_x_m"], rel=0.05)  # type: ignore[index]
    assert called(capsys, folder / "run.h5", "--ruler-mm", "1")[0] == 2


def test_a_scan_that_was_aimed_wrongly_has_one_place_and_a_warning_that_stays(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The beam went where a wall at 2.0 m is; the scan believed 2.1 m and a scanner aside."""
    bench = json.loads(Recording.open(folder / "run.h5").header.bench_json)
    wrong = tmp_path / "wrong.yaml"
    bench["geometry"] |= {"wall_distance_m": 2.1, "scanner_x_m": 0.1}
    bench["simulation"]["misalignment"] |= {"wall_distance_m": 2.0, "scanner_x_m": 0.0}
    wrong.write_text(json.dumps(bench))
    (tmp_path / "scan.yaml").write_text(SCAN)
    assert nlos(["scan", str(tmp_path / "scan.yaml"), "--bench", str(wrong), "-o", str(tmp_path / "w.h5")]) == 0
    capsys.readouterr()
    code, told = called(capsys, tmp_path / "w.h5", "-o", tmp_path / "c.h5")
    assert code == 0, told
    (said,) = told["warnings"]  # type: ignore[misc]
    assert "the beam did not land where the plan says" in str(said)
    error_m = told["geometry_errors"]["wall_distance_m"]  # type: ignore[index]
    assert told["wall_distance_m"] == pytest.approx(2.0, abs=4 * error_m)
    assert told["scanner_position_m"][2] == told["wall_distance_m"]  # type: ignore[index]
    assert load(tmp_path / "c.h5").warnings == (said,)
    assert nlos(["info", str(tmp_path / "c.h5")]) == 0
    assert "did not land" in capsys.readouterr().out
    code, told = called(
        capsys, tmp_path / "w.h5", "-o", tmp_path / "d.h5", "--spots", write_spots(tmp_path / "spots.csv")
    )
    assert code == 0, told
    assert told["scanner_position_m"] == pytest.approx([0.0, 0.0, 2.0], abs=3e-3)
    assert any("from where it was aimed" in str(each) for each in told["warnings"])  # type: ignore[attr-defined]
    assert not load(
        tmp_path / "d.h5"
    ).warnings  # it is this scan's: those that these constants aim land where they should
    arrivals = load(tmp_path / "d.h5").arrivals
    assert arrivals is not None
    assert arrivals.scanner_position_m == pytest.approx([0.0, 0.0, 2.0], abs=5e-3)


def test_constants_named_as_a_run_are_called_constants(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(capsys, folder / "plain.h5", "-o", tmp_path / "c.h5")[0] == 0
    code, told = called(capsys, tmp_path / "c.h5", "-o", tmp_path / "d.h5")
    assert code == 7
    assert "holds a bench's constants" in told["error"]["message"]  # type: ignore[index]


def test_the_report_gives_place_and_delay_to_the_digits_of_their_errors(folder: Path, tmp_path: Path) -> None:
    assert nlos(["report", str(folder / "run.h5"), "-o", str(tmp_path / "r.html")]) == 0
    text = (tmp_path / "r.html").read_text("utf-8")
    place = re.search(r"<th[^>]*>Scanner, from[^<]* own axes[^<]*</th><td>([^<]*)<", text)
    delay = re.search(r"<th[^>]*>Delay of cables[^<]*</th><td>([0-9.-]+) ± ([0-9.]+)<", text)
    assert place is not None
    assert delay is not None
    for said in place[1].split(", "):  # mm
        value, error = said.split(" ± ")
        assert len(value.partition(".")[2]) == len(error.partition(".")[2])
        assert len(error.replace(".", "").lstrip("0").rstrip("0")) in (1, 2)
    assert abs(float(delay[1]) - 0.35) < 4 * float(delay[2])

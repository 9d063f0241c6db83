"""A mirror and a counter in a package of their own are found by entry point, and need no line of ours."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
BENCH = """
name: acme
mirror: {model: acme_galvo, port: "PORT"}
counter: {model: acme_counter, device: hydraharp400, library: LIBRARY}
shutter: {model: acme_shutter}
geometry: {wall_distance_m: 2.0}
safety: {watchdog_s: 0.0}
"""
SIMULATED = BENCH.replace("PORT", "sim://acme").replace("LIBRARY", "simulated")
SCENE = "simulation: {scene: {surfel_m: 0.05, objects: [{letter: L, centre_m: [0, 0, 0.7], height_m: 0.4}]}}\n"
SCAN = """
wall: {width_m: 0.4, height_m: 0.4, rows: 4, cols: 4}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 512, bin_width_ps: 32.0, offset_ns: 8.0}
"""


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder with the package installed as pip would: its files, and a dist-info that names its entry points."""
    site = tmp_path / "site"
    shutil.copytree(HERE / "acme_optics", site / "acme_optics", ignore=shutil.ignore_patterns("__pycache__"))
    about = site / "acme_optics-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-optics\nVersion: 1.0\n", "utf-8")
    (about / "entry_points.txt").write_text(
        "[nlos.mirrors]\nacme_galvo = acme_optics:MIRROR\n\n[nlos.counters]\nacme_counter = acme_optics:COUNTER\n",
        "utf-8",
    )
    (tmp_path / "bench.yaml").write_text(SIMULATED + SCENE, "utf-8")
    (tmp_path / "scan.yaml").write_text(SCAN, "utf-8")
    return tmp_path


def nlos(lab: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(lab / "site"), os.environ.get("PYTHONPATH", "")))}
    command = [sys.executable, "-m", "nlos", *words]
    return subprocess.run(command, cwd=lab, env=environment, capture_output=True, text=True, timeout=240, check=False)


def test_its_devices_are_scanned_with_like_ours(lab: Path) -> None:
    done = nlos(lab, "scan", "scan.yaml", "--bench", "bench.yaml", "-o", "run.h5")
    assert done.returncode == 0, done.stderr
    done = nlos(lab, "info", "run.h5", "--json")
    assert done.returncode == 0, done.stderr
    assert "acme_galvo" in done.stdout
    assert "acme_counter" in done.stdout
    done = nlos(lab, "plan", "scan.yaml", "--bench", "bench.yaml", "--json")
    assert done.returncode == 0, done.stderr
    done = nlos(lab, "shutter", "close", "--bench", "bench.yaml")
    assert done.returncode == 0, done.stderr


def test_its_faults_are_rehearsed_by_name_and_stand_in_the_table(lab: Path) -> None:
    fault = "simulation: {faults: [{name: ACME1, after_s: 0.3}], scene:"
    (lab / "bench.yaml").write_text(SIMULATED + SCENE.replace("simulation: {scene:", fault), "utf-8")
    done = nlos(lab, "scan", "scan.yaml", "--bench", "bench.yaml", "-o", "run.h5")
    assert done.returncode == 3, done.stderr
    assert "acme_galvo did not move" in done.stderr.replace(":", "")
    catalogue = "nlos.drivers.simulated.fault_catalogue"
    environment = os.environ | {"PYTHONPATH": str(lab / "site")}
    page = subprocess.run(
        [sys.executable, "-m", catalogue], cwd=lab, env=environment, capture_output=True, text=True, check=True
    ).stdout
    assert "| ACME1 | it says no |" in page
    (lab / "bench.yaml").write_text(
        SIMULATED + SCENE.replace("simulation: {scene:", fault.replace("E1", "E2")), "utf-8"
    )
    done = nlos(lab, "plan", "scan.yaml", "--bench", "bench.yaml")
    assert done.returncode == 2
    assert "no fault of that name" in done.stderr


def test_a_bench_file_is_made_of_them_by_questions(lab: Path) -> None:
    words = ("new", "bench", "--simulated", "--no-check", "--answer=mirror=acme_galvo", "--answer=counter=acme_counter")
    done = nlos(lab, *words, "-o", "made.yaml")
    assert done.returncode == 0, done.stderr
    text = (lab / "made.yaml").read_text("utf-8")
    assert "model: acme_galvo" in text
    assert "max_mechanical_deg" not in text
    module = lab / "site" / "acme_optics" / "__init__.py"
    module.write_text(module.read_text("utf-8").replace("max_rad: float = 0.5", "max_rad: float"), "utf-8")
    done = nlos(lab, *words, "-o", "other.yaml")
    assert done.returncode == 2
    assert "its mirror needs `max_rad` too, which nobody asks for here: write the file by hand" in done.stderr


def test_where_they_are_missing_they_are_named_with_a_remedy_and_their_udev_rule(lab: Path) -> None:
    (lab / "bench.yaml").write_text(BENCH.replace("PORT", "/dev/ttyACME").replace("LIBRARY", "/no/such.so"), "utf-8")
    done = nlos(lab, "devices", "--bench", "bench.yaml")
    assert done.returncode == 3
    assert "MISSING  mirror acme_galvo at /dev/ttyACME" in done.stdout
    assert "MISSING  counter acme_counter at /no/such.so" in done.stdout


def test_their_settings_and_shutter_are_in_the_schema_and_in_what_a_wrong_word_is_told(lab: Path) -> None:
    schema = json.loads(nlos(lab, "schema", "bench").stdout)
    assert schema["$defs"]["AcmeSettings"]["properties"]["max_rad"]["description"].startswith("How far the beam")
    assert "acme_shutter" in schema["$defs"]["ShutterSettings"]["properties"]["model"]["enum"]
    (lab / "bench.yaml").write_text((SIMULATED + SCENE).replace("model: acme_galvo", "model: acme_gavlo"), "utf-8")
    done = nlos(lab, "plan", "scan.yaml", "--bench", "bench.yaml")
    assert done.returncode == 2
    assert "Did you mean 'acme_galvo'?" in done.stderr


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("broken = acme_optics:NOTHING", "no attribute 'NOTHING'"),
        ("broken = no_such_module:MIRROR", "No module named 'no_such_module'"),
        ("broken = acme_optics:AcmeMirror", "is not an nlos.drivers.device_model.DeviceModel"),
        ("broken = acme_optics:COUNTER", "does not derive from nlos.drivers.galvo.block.MirrorBlock"),
        ("twice = acme_optics:MIRROR", "a model acme_galvo already exists"),
    ],
)
def test_a_package_that_cannot_be_used_is_named_and_the_others_still_work(lab: Path, line: str, why: str) -> None:
    points = lab / "site" / "acme_optics-1.0.dist-info" / "entry_points.txt"
    points.write_text(points.read_text("utf-8").replace("[nlos.mirrors]\n", f"[nlos.mirrors]\n{line}\n"), "utf-8")
    done = nlos(lab, "devices", "--bench", "bench.yaml")
    assert done.returncode == 0, done.stderr
    assert why in done.stderr
    assert "of acme-optics cannot be used" in done.stderr


def test_without_the_package_its_word_is_unknown(lab: Path) -> None:
    shutil.rmtree(lab / "site")
    done = nlos(lab, "devices", "--bench", "bench.yaml")
    assert done.returncode == 2
    assert "must be one of" in done.stderr
    assert "of another package is there once that is installed" in done.stderr


def test_no_room_but_drivers_decides_by_the_name_of_a_model() -> None:
    """The words of our own models are in the driver's own folders and nowhere in code that decides anything."""
    from nlos.drivers.galvo.known_mirrors import MIRRORS
    from nlos.drivers.tcspc.known_counters import COUNTERS

    top = HERE.parents[1]
    words = {
        *MIRRORS,
        *COUNTERS,
        *(word for models in (MIRRORS, COUNTERS) for m in models.values() for word in m.shutters),
    }
    shared = [*(top / "drivers").glob("*.py"), *(top / "drivers/link").glob("*.py")]
    above = [path for room in ("acquisition", "calibration", "recon") for path in (top / room).rglob("*.py")]
    for path in (*shared, *above, *(top / "src/nlos").rglob("*.py")):
        text = path.read_text("utf-8")
        named = [word for word in words if f'"{word}"' in text or f"'{word}'" in text]
        assert not named, f"{path.relative_to(top)} decides by {named}"

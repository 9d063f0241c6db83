"""A folder with the example package of docs/howto/ni-daqmx installed as pip would, a bench file and a small scan."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "docs" / "howto" / "ni-daqmx"
BENCH = """
name: ni
mirror:
  {model: ni_daqmx, library: simulated, x: {volts_per_degree: 0.8}, y: {volts_per_degree: -0.5, offset_v: 0.25},
   max_mechanical_deg: 12.0, shutter_line: Dev1/port0/line0}
counter: {model: picoquant, device: hydraharp400, library: simulated}
shutter: {model: ni_daqmx_line}
geometry: {wall_distance_m: 2.0}
simulation: {scene: {surfel_m: 0.05, objects: [{letter: L, centre_m: [0, 0, 0.7], height_m: 0.4}]}}
"""
SCAN = """
wall: {width_m: 0.4, height_m: 0.4, rows: 4, cols: 4}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 512, bin_width_ps: 32.0, offset_ns: 8.0}
"""


def installed(folder: Path, point: str = "nlos_ni_daqmx:MIRROR") -> Path:
    """`point` is the entry point's object."""
    site = folder / "site"
    about = site / "nlos_ni_daqmx-0.1.dist-info"
    about.mkdir(parents=True)
    shutil.copy(EXAMPLE / "nlos_ni_daqmx.py", site)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: nlos-ni-daqmx\nVersion: 0.1\n", "utf-8")
    (about / "entry_points.txt").write_text(f"[nlos.mirrors]\nni_daqmx = {point}\n", "utf-8")
    (folder / "bench.yaml").write_text(BENCH, "utf-8")
    (folder / "scan.yaml").write_text(SCAN, "utf-8")
    return folder


def nlos(folder: Path, *words: str, **more: str) -> "subprocess.CompletedProcess[str]":
    """A process of its own: models are looked for as the program begins. `more`: of its environment."""
    path = os.pathsep.join((str(folder / "site"), os.environ.get("PYTHONPATH", "")))
    environment = os.environ | {"PYTHONPATH": path} | more
    command = [sys.executable, "-m", "nlos", *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=240, check=False
    )

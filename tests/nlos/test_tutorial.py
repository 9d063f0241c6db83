"""The tutorial's commands work as they are printed."""

import os
import re
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).parents[2]


def test_the_tutorial_runs(tmp_path: Path) -> None:
    text = (TOP / "docs" / "tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.S | re.M)
    script = "\n".join(blocks).replace("make demo\n", "").replace('export PATH="$PWD/.venv/bin:$PATH"\n', "")
    assert script.count("nlos scan") == 3
    here = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script], cwd=tmp_path, env=here, capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stdout + done.stderr
    mine = tmp_path / "runs" / "mine"
    for name in (
        "run.h5",
        "early/albedo.png",
        "run/albedo.png",
        "run/depth.png",
        "smooth/albedo.png",
        "run.npz",
        "run.mat",
        "run.html",
    ):
        assert (mine / name).stat().st_size > 1000, name

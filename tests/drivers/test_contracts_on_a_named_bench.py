"""`pytest tests/drivers --bench LAB`: the contracts on a bench that is taken for a real one, in the dark."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "pytest", "tests/drivers", "-rs", "-p", "no:cacheprovider"]


@pytest.mark.parametrize("name", ["simulated", "optotune", "multiharp"])
def test_contracts_hold_and_what_the_bench_lacks_is_skipped_by_name(name: str, tmp_path: Path) -> None:
    text = (TOP / "configs" / "bench" / f"{name}.yaml").read_text("utf-8")
    witness = tmp_path / "witness"
    bench = tmp_path / "lab.yaml"
    bench.write_text(text.replace("simulation:\n", f"simulation:\n  witness: {witness}\n"), "utf-8")
    done = subprocess.run([*COMMAND, "--bench", str(bench)], cwd=TOP, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= 20
    said = done.stdout
    assert "faults are provoked on simulated benches" in said
    assert ("does not measure where it points" in said) == (name != "optotune")
    assert "shutter open" not in witness.read_text("utf-8")

"""How fast a training goes, whether it waits for its samples, and what a second process brings; seconds are wall time.

The U-Net that ships, 64 x 64 points and 512 bins, every scene made once and none cached: on one core for each process,
and one that makes samples beside it. `before` is a thread that makes them, as it was. Two ranks learn from cached
scenes, so that two cores are theirs alone. `python benchmarks/training.py` on two cores that do nothing else.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

SAMPLES, CACHED = 60, 60
RUN = """
import json, sys, time
from pathlib import Path
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
at = []
settings = TrainSettings.model_validate_json(sys.argv[2])
def progress(step, steps, loss):
    at.append(time.monotonic())
if __name__ == "__main__":
    done = train(settings, Path(sys.argv[1]), lambda line: None, progress=progress)
if at:
    print(json.dumps({"rate": settings.batch * (len(at) - 1) / (at[-1] - at[0]), "data_wait": done["data_wait"]}))
"""


def figure(name: str, value: float, unit: str, target: float | None = None, at_most: bool = False) -> None:
    met = None if target is None else bool(value <= target if at_most else value >= target)
    print(
        json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}), flush=True
    )


def training(folder: Path, ranks: int = 1, **changes: Any) -> dict[str, float]:
    """Samples a second and the part of the time that the first network waited for them."""
    data = {"scenes": 4000, "degradations": 1, "bins": 512, "bin_width_ps": 32.0}
    settings = {
        "method": "unet", "data": data, "validation": {"scenes": 1, "degradations": 1, "held_out": True}, "cache": None,
        "samples": SAMPLES, "warm_up_steps": 1, "checkpoint_minutes": 60.0,
    } | changes  # fmt: skip
    words = [sys.executable] if ranks == 1 else [
        sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", str(ranks), "--master-port", "29611"
    ]  # fmt: skip
    script = folder / "run.py"
    script.write_text(RUN)
    where = folder / f"run{len(list(folder.iterdir()))}"
    done = subprocess.run(
        [*words, str(script), str(where), json.dumps(settings)], env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    found: dict[str, float] = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    return found


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        before = training(folder, workers=0)
        figure("samples_per_s_before", before["rate"], "1/s")
        figure("data_wait_before", before["data_wait"], "of the time")
        after = training(folder, workers=1)
        figure("samples_per_s", after["rate"], "1/s")
        figure("data_wait", after["data_wait"], "of the time", 0.05, at_most=True)
        few = {"scenes": CACHED, "degradations": 1, "bins": 512, "bin_width_ps": 32.0}
        cached = {"workers": 0, "cache": str(folder / "scenes"), "data": few, "samples": 2 * CACHED}
        training(folder, **cached)
        one, two = training(folder, **cached), training(folder, ranks=2, **cached)
        figure("two_ranks", two["rate"] / one["rate"], "times as fast as one", 1.8)


if __name__ == "__main__":
    main()

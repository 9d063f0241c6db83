"""The paper's table VI, and the memory of its table VII: parameters, time and memory of networks, trained and used.

`python -m studies.complexity PAGE.md` measures each in a process of its own on one thread, so that memory is a
network's own and time is processor time, which other programs change little.
"""

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from nlos.recon.methods import find
from nlos.recon.peak_memory import forget_peak, peak_rss_mb
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.losses import LossSettings
from nlos.recon.training.network import build, objective
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from studies.machine import machine
from studies.results.tables import table

TRAINED_AT: dict[str, Any] = {"rows": 64, "cols": 64, "bins": 256, "bin_width_ps": 64.0}
USED_AT: dict[str, Any] = {"rows": 128, "cols": 128, "bins": 512, "bin_width_ps": 33.0}
"""As in the paper (section V-A)."""
STEPS = 3
PICTURES = 2
PRINTED: dict[str, Any] = {"channels": [8, 16, 32, 64, 64], "sfe_bandwidth": 5700}
"""As in configs/train/faithful.yaml."""


@dataclass(frozen=True)
class Measured:
    """One network, and what the paper says of it."""

    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    paper: str = "-"


NETWORKS: dict[str, Measured] = {
    "LFE": Measured("lfe", {"farthest": 0.9}, "10 h / 0.03 s, 4 G, 0.03 M"),
    "NLOST": Measured("nlost", {"farthest": 0.9}, "38 h / 0.61 s, 38 G, 1 M"),
    "printed network, no SFE": Measured("faithful", PRINTED | {"sfe": False}, "30 h / 0.50 s, 10 G, 4 M"),
    "printed network": Measured("faithful", PRINTED, "32 h / 0.53 s, 14 G, 70 M"),
    "NANO as it ships": Measured("nano", {"symmetries": False}),
}
PASSES: dict[str, Measured] = {
    f"S = {s}": Measured("faithful", PRINTED | {"outer_iterations": s}, f"{memory} G")
    for s, memory in ((1, 14), (2, 18), (3, 23), (4, 26), (5, 30), (6, 34))
}


def trained(network: Measured) -> dict[str, float]:
    """Parameters, processor time of a step and peak memory while it is trained."""
    settings = TrainSettings(
        method=network.method, method_settings=dict(network.settings), loss=LossSettings(depth=0.0), batch=1,
        data=DatasetSettings(scenes=1, degradations=1, **TRAINED_AT),
    )  # fmt: skip
    batch = collate([sample(settings.data, 0)])
    forget_peak()
    made = build(settings, settings.data.wall, settings.data.time)
    parameters = [p for p in made.parameters() if p.requires_grad]
    optimiser = torch.optim.AdamW(parameters, lr=1e-6)
    took = []
    for _ in range(STEPS):
        begun = time.thread_time()
        objective(made, batch, settings, "cpu")["loss"].backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        optimiser.zero_grad()
        took.append(time.thread_time() - begun)
    return {"parameters_m": sum(p.numel() for p in parameters) / 1e6, "step_s": min(took), "trained_gb": _gb()}


def used(network: Measured) -> dict[str, float]:
    """Processor time of a picture and peak memory while it is made."""
    data = DatasetSettings(scenes=1, degradations=1, **USED_AT)
    batch = collate([sample(data, 0)])
    forget_peak()
    method = find(network.method)
    own = {"weights": None} if network.method == "faithful" else {}
    made = method.build(
        method.Settings.model_validate_json(json.dumps(own | dict(network.settings))), data.wall, data.time
    ).eval()
    took = []
    with torch.inference_mode():
        for _ in range(PICTURES):
            begun = time.thread_time()
            made(batch["counts"], batch["exposure"])
            took.append(time.thread_time() - begun)
    return {"picture_s": min(took), "used_gb": _gb()}


def _gb() -> float:
    return peak_rss_mb() * 2**20 / 1e9


def alone(name: str, what: str) -> dict[str, float]:
    """Measured in a process of its own."""
    command = [sys.executable, "-m", "studies.complexity", name, what]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=3600)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def page() -> str:
    """docs/complexity.md."""
    lines = [
        "# Time and memory, as the paper's table VI has them",
        "",
        "Trained at {rows} x {cols} points and {bins} bins, one sample a step;".format(**TRAINED_AT),
        "used at {rows} x {cols} points and {bins} bins, seen once. Processor time of one thread".format(**USED_AT),
        f"({machine()}, shared with other programs), the best of {STEPS}",
        f"steps and of {PICTURES} pictures, each network in a process of its own; PyTorch and the scan are",
        "in the memory. Parameters are those that are trained: NANO's frozen noise estimation and its refinement are",
        "not among them. The paper's column: training / picture, memory, parameters, on four RTX A6000: compare",
        "ratios. Made by `python -m studies.complexity docs/complexity.md`.",
        "",
    ]
    rows = []
    for name, network in NETWORKS.items():
        a, b = alone(name, "trained"), alone(name, "used")
        rows.append([
            name, f"{a['parameters_m']:.2f}", f"{a['step_s']:.2f}", f"{a['trained_gb']:.1f}", f"{b['picture_s']:.1f}",
            f"{b['used_gb']:.1f}", network.paper,
        ])  # fmt: skip
    heads = ["network", "trainable, M", "s a step", "GB trained", "s a picture", "GB used", "paper"]
    lines += [
        table(heads, rows),
        "Memory by passes of algorithm 1, as in its table VII, of the printed network above, which has the paper's",
        "size (configs/train/faithful.yaml) and was not trained; what is judged on other pages has 2.3 M parameters,",
        "B = 256:",
        "",
    ]
    rows = []
    for name, network in PASSES.items():
        a = alone(name, "trained")
        rows.append([name, f"{a['step_s']:.2f}", f"{a['trained_gb']:.1f}", network.paper])
    return "\n".join([*lines, table(["printed network", "s a step", "GB trained", "paper"], rows)])


if __name__ == "__main__":
    if len(sys.argv) == 2:
        Path(sys.argv[1]).write_text(page(), encoding="utf-8")
    else:
        torch.set_num_threads(1)
        measured = (NETWORKS | PASSES)[sys.argv[1]]
        print(json.dumps({"trained": trained, "used": used}[sys.argv[2]](measured)))

"""How much LFE and NLOST lose from noise when they are trained without it, which its paper did not do, and with it."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.recon.evaluate import as_json, evaluate
from nlos.recon.training.log import finished
from nlos.recon.training.run_folder import WEIGHTS
from nlos.recon.weights.files import read_weights
from studies.results.kept import kept, of_code, of_files, weights_path
from studies.results.quality import Quality
from studies.results.tables import mean, of, pick, samples_seen, shown, table

CONDITIONS = ("transient", "counts_p20", "counts_p5", "counts_p1")
RIVALS = ("lfe", "nlost")


def weights_of(method: str) -> Path | None:
    """The weights of `configs/train/METHOD_noiseless.yaml`, shipped or in their finished run; None without any."""
    name = f"{method}_noiseless"
    run = Path("runs/train") / name
    if weights_path(name).exists():
        return weights_path(name)
    return run / WEIGHTS if finished(run) else None


def noiseless(data: Path, quality: Quality) -> str:
    """PSNR by condition with either training, and what p20 and p1 cost."""
    body, absent = [], []
    for method in RIVALS:
        path = weights_of(method)
        if path is None:
            absent.append(method)
        else:
            rows = _measured(data, quality, method, path)
            seen = samples_seen(path.stem, path.parent)
            name = f"{method}, {seen:,} samples without noise"
            body.append(_line(name, [mean(pick(rows, condition=c), "psnr") for c in CONDITIONS]))
        name = f"{method}, {samples_seen(method):,} samples with noise"
        body.append(_line(name, [of(quality.rows, method, c, "psnr") for c in CONDITIONS]))
    body.append(_line("nano", [of(quality.rows, "nano", c, "psnr") for c in CONDITIONS]))
    text = table(["PSNR, dB", *CONDITIONS, "lost to p20", "lost to p1"], body)
    if absent:
        configurations = ", ".join(f"configs/train/{method}_noiseless.yaml" for method in absent)
        text += f"\nNot trained without noise on 4,000 samples yet: {', '.join(absent)} "
        text += f"(`nlos train` with {configurations}).\n"
        text += "Networks of 1,000 samples were: [the paper, claim by claim](paper.md).\n"
    return text


def _measured(data: Path, quality: Quality, method: str, weights: Path) -> list[dict[str, Any]]:
    depends = {
        "code": of_code(method), "weights": of_files([weights]), "data": of_files(s.path for s in quality.scenes)
    }  # fmt: skip

    def measure(_: Path) -> tuple[Any, dict[str, npt.NDArray[np.float32]]]:
        trained_with = read_weights(weights).about["settings"]["method_settings"]
        settings = trained_with | {"weights": str(weights)}
        done = evaluate([data], [method], CONDITIONS, settings=settings, say=print)
        return as_json(done.rows), {}

    found: list[dict[str, Any]] = kept(f"{method}-noiseless", depends, measure).figures
    return found


def _line(name: str, values: list[float | None]) -> list[str]:
    lost = [None if a is None or b is None else a - b for a, b in ((values[0], values[1]), (values[0], values[3]))]
    return [name, *(shown(value, 2) for value in values), *(shown(value, 2) for value in lost)]

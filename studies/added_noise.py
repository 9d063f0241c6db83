"""Noise added to measured scans, as the paper's figure of real scenes under noise has it: pictures, method by method.

U(0, a) in every bin of every measured point, on the scale on which the scan's brightest bin is 255, on top of the
scan's own noise. `python -m studies.added_noise ../shared/data/real docs/results/added_noise.png` draws, and prints the
correlation of each picture with the same method's without added noise: how little it changes, not how right it is.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.transient import Transient
from nlos.recon.methods import find
from nlos.recon.metrics import correlation
from nlos.recon.reconstruct import reconstruct
from nlos.recon.weights.files import place_of

SCENES = {"otoole_s_u": "S and U", "otoole_resolution_40cm": "chart", "statue_full": "statue"}
METHODS = ("lct", "fk", "phasor", "lfe", "nano", "faithful")
AMPLITUDES = (0.0, 10.0, 30.0, 100.0)
WHITE = 255.0


def with_noise(transient: Transient, amplitude: float, seed: int = 1) -> Transient:
    """U(0, amplitude) added where the scan was measured; its brightest bin is 255."""
    unit = float(transient.counts.max()) / WHITE
    noise = np.random.default_rng(seed).random(transient.counts.shape, dtype=np.float32)
    added = np.float32(amplitude * unit) * noise * (transient.exposure_s > 0)
    return replace(transient, counts=transient.counts + added)


def behind_direct_light(path: Path) -> tuple[Transient, int]:
    """The measured counts without the direct light, and the falloff of their surfaces."""
    read = read_plain(path)
    counts = read.transient.counts.copy()
    counts[: read.direct_cut_bins] = 0
    return replace(read.transient, counts=counts), read.falloff or 4


def front_view(transient: Transient, method: str, falloff: int) -> npt.NDArray[np.float32]:
    """The picture over its 99.9th percentile, 0 to 1."""
    settings: dict[str, object] = {"falloff": falloff} if "falloff" in find(method).Settings.model_fields else {}
    albedo = reconstruct(transient, method, settings).albedo
    return np.asarray(np.clip(albedo / (float(np.quantile(albedo, 0.999)) or 1.0), 0, 1), dtype=np.float32)


def main(data: Path, picture: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    methods = [method for method in METHODS if method != "faithful" or place_of(method).exists()]
    rows = [(scene, amplitude) for scene in SCENES for amplitude in AMPLITUDES]
    drawing = Figure(figsize=(1.2 * len(methods) + 0.4, 1.2 * len(rows) + 0.3), layout="constrained")
    FigureCanvasAgg(drawing)
    grid = drawing.subplots(len(rows), len(methods), squeeze=False)
    print("| scene | a | " + " | ".join(methods) + " |\n" + "|---" * (2 + len(methods)) + "|")
    clean: dict[str, npt.NDArray[np.float32]] = {}
    for line, (scene, amplitude) in zip(grid, rows, strict=True):
        transient, falloff = behind_direct_light(data / f"{scene}.h5")
        noisy = with_noise(transient, amplitude) if amplitude else transient
        line[0].set_ylabel(f"{SCENES[scene]}\na = {amplitude:g}", fontsize=6)
        kept = []
        for axes, method in zip(line, methods, strict=True):
            seen = front_view(noisy, method, falloff)
            if not amplitude:
                clean[method] = seen
            kept.append(f"{correlation(seen, clean[method]):.2f}")
            axes.imshow(seen, cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
        print(f"| {scene} | {amplitude:g} | " + " | ".join(kept) + " |", flush=True)
    for axes, method in zip(grid[0], methods, strict=True):
        axes.set_title(method, fontsize=8)
    picture.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(picture, dpi=100, metadata={"Software": "nlos"})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

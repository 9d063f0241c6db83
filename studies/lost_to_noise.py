"""What uniform noise costs, as the paper's table II asks: PSNR of noiseless rendered scans with and without it.

U(0, a) in every bin on the scale on which a scan's brightest bin is 255; a of 10 is the most that the paper trains
with. `python -m studies.lost_to_noise ../shared/data/synthetic [A ...]` prints the table of docs/paper.md. The
light-cone transform and f-k run at the best of five snr, with and without noise.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nlos.acquisition.transient import Transient
from nlos.recon.entrants import choices
from nlos.recon.metrics import image_scores
from nlos.recon.reconstruct import reconstruct
from nlos.recon.truth_scenes import Scene, find_scenes, transient_of
from studies.added_noise import with_noise
from studies.paired import Figures, difference
from studies.results.kept import BASE, WEIGHTS_OF
from studies.results.quality import AS_TRAINED
from studies.results.tables import table
from studies.snr import snr_db

METHODS = ("lct", "fk", "lfe_4000", "nlost_4000", "unet_4000", "faithful", "nano_4000_once", "nano")
PAPER = {"lct": -0.01, "fk": -2.03, "lfe_4000": -3.01, "nlost_4000": -5.68, "faithful": -0.03}
"""Its table II less its table I."""
AMPLITUDES = (3.0, 10.0, 30.0)
"""Of which the first makes about the 15 to 20 dB of the paper's noisy test set."""


def psnr(name: str, scenes: Sequence[Scene], transients: Sequence[Transient]) -> Figures:
    """(1, scenes), at the snr with the best mean where the method has one."""
    method = BASE.get(name, name)
    weights = {"weights": WEIGHTS_OF.get(name, name)} | AS_TRAINED.get(name, {}) if name in BASE else {}
    tried = []
    for settings in choices(method, weights, fixed=False):
        pictures = [reconstruct(transient, method, settings).albedo for transient in transients]
        pairs = zip(pictures, scenes, strict=True)
        tried.append([image_scores(picture, scene.intensity)["psnr"] for picture, scene in pairs])
    return np.array([max(tried, key=lambda values: float(np.mean(values)))])


def main(data: Path, amplitudes: Sequence[float] = AMPLITUDES) -> None:
    """The table, a line a method, and the signal to noise ratio of the noisy scans."""
    scenes = list(find_scenes([data], lambda _: None))
    clean = [transient_of(scene, "transient") for scene in scenes]
    noisy = {a: [with_noise(each, a, seed) for seed, each in enumerate(clean)] for a in amplitudes}
    for amplitude, scans in noisy.items():
        found = [snr_db(scan.counts, each.counts) for scan, each in zip(scans, clean, strict=True)]
        print(f"a = {amplitude:g}: {np.mean(found):.1f} dB, {min(found):.1f} to {max(found):.1f}", flush=True)
    body = []
    for name in METHODS:
        whole = psnr(name, scenes, clean)
        line = [name, f"{whole.mean():.2f}"]
        for scans in noisy.values():
            seen = psnr(name, scenes, scans)
            line += [f"{seen.mean():.2f}", str(difference(seen, whole))]
        body.append([*line, f"{PAPER[name]:+.2f}" if name in PAPER else "-"])
        print(" | ".join(body[-1]), file=sys.stderr, flush=True)
    heads = [head for a in amplitudes for head in (f"a = {a:g}", "difference")]
    print(table(["PSNR, dB", "noiseless", *heads, "paper, difference"], body))


if __name__ == "__main__":
    main(Path(sys.argv[1]), [float(word) for word in sys.argv[2:]] or AMPLITUDES)

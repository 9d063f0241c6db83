"""How many decibels a scan has: signal energy over noise energy, both over all bins of all points measured.

SNR = 10 log10(sum (a s)^2 / sum (c - a s - b)^2), c the counts, s the noiseless transient, a and b the scale and the
flat background that fit best. `python -m studies.snr ../shared/data/synthetic` prints those of the rendered scenes.
"""

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.recon.truth_scenes import find_scenes, transient_of

Cube = npt.NDArray[np.float32] | npt.NDArray[np.float64]
CONDITIONS = ("counts_p20", "counts_p5", "counts_p1")


def snr_db(counts: Cube, transient: Cube, measured: npt.NDArray[np.bool_] | None = None) -> float:
    """Of counts (T, H, W) whose expectation is proportional to `transient` (T, H, W) over a flat background."""
    if measured is not None:
        counts, transient = counts[:, measured], transient[:, measured]
    c, s = (np.asarray(x, dtype=np.float64).ravel() for x in (counts, transient))
    centred = s - s.mean()
    scale = float(np.vdot(centred, c) / np.vdot(centred, centred))
    rest = c - scale * s
    noise = float(np.square(rest - rest.mean()).sum())
    return float(10 * np.log10(scale**2 * float(np.vdot(s, s)) / max(noise, 1e-30)))


def main(data: Path) -> None:
    """One line a scene and condition."""
    for condition in CONDITIONS:
        found = []
        for scene in find_scenes([data], lambda _: None):
            clean = transient_of(scene, "transient")
            found.append(snr_db(transient_of(scene, condition).counts, clean.counts, clean.exposure_s > 0))
        each = " ".join(f"{value:.1f}" for value in found)
        print(f"{condition}: {np.mean(found):.1f} dB ({each})")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

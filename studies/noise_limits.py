"""What keeps the noise of coarse scans from being told: the noise itself, or the signal that it is compared with?

`python -m studies.noise_limits [POINTS]` fits networks like those of `studies.any_noise` to scans of so many points a
side (16), once to what a scan tells, once told the true peak of the signal as well, once the true deviation of the
noise, and prints R^2, bias and scatter in decades on scenes of held-out kinds, a line of Markdown each.
"""

import sys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.dataset import _transient
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings, _choose, _responses, measure, respond
from nlos.recon.training.scenes import make_scene
from studies.any_noise import fit_one, traits_of
from studies.noise_figure import KINDS, NoiseFit
from studies.results.tables import table

LEARNED, JUDGED = 1500, 80  # scenes, each measured once with every kind of noise
SEED, HELD_OUT_SEED = 31, 3
Numbers = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Scans:
    """Some scans: what they tell (N, F), log10 of their noise level, of the signal's peak over its mean, and which
    kind of noise, (N,) each."""

    traits: Numbers
    level: Numbers
    peak: Numbers
    kind: npt.NDArray[np.int64]

    def told(self, what: str) -> Numbers:
        """The traits, and beside them the peak, or the noise's deviation over the signal's mean."""
        more = {"nothing": [], "peak": [self.peak], "deviation": [self.level + self.peak]}[what]
        return np.column_stack([self.traits, *more]).astype(np.float32)


def drawn(network: Nano, data: DatasetSettings, scenes: int) -> Scans:
    """Whole scans of the first `scenes` scenes, with every kind of noise."""
    rows: list[tuple[Numbers, float, float, int]] = []
    for number in range(1, scenes + 1):
        shown = make_scene(data.seed, number, data.wall, held_out=data.held_out, kinds=())
        light = _transient(data, shown, np.random.default_rng((data.seed, number)))
        for kind, detector in enumerate(KINDS.values() if light.max() > 0 else ()):
            whole, seed = detector.model_copy(update={"sparse": 0.0}), (data.seed, number, kind, int(data.held_out))
            try:
                got = measure(light, data.time, whole, np.random.default_rng(seed))
            except ValueError:  # no light inside the time axis
                continue
            traits = traits_of(network, data, got.counts.astype(np.float32), got.exposure)
            seen = respond(light, _response(whole, data, np.random.default_rng(seed)))
            peak = float(np.log10(seen.max(axis=0).mean() / seen.mean()))
            if np.isfinite(traits).all():
                rows.append((traits, float(np.log10(got.noise_level)), peak, kind))
    level, peaks = (np.array([row[at] for row in rows], np.float32) for at in (1, 2))
    return Scans(np.array([row[0] for row in rows]), level, peaks, np.array([row[3] for row in rows]))


def _response(detector: DetectorSettings, data: DatasetSettings, draw: np.random.Generator) -> npt.NDArray[np.float64]:
    """The one that `measure` draws."""
    _choose(detector, draw)
    return _responses(data.time, detector, draw, ())[0]


def fitted(learned: Scans, judged: Scans, what: str, members: int = 3) -> Numbers:
    """Levels of `judged` by the mean of a few networks fitted to `learned`."""
    inputs, wanted = torch.from_numpy(learned.told(what)), torch.from_numpy(learned.level)
    found = []
    for seed in range(members):
        torch.manual_seed(seed)
        width = inputs.shape[1]
        member = nn.Sequential(nn.Linear(width, 64), nn.GELU(), nn.Linear(64, 64), nn.GELU(), nn.Linear(64, 1))
        fit_one(member, inputs, wanted)
        with torch.no_grad():
            found.append(member(torch.from_numpy(judged.told(what)))[:, 0].numpy())
    return np.asarray(np.mean(found, axis=0), np.float32)


def main(points: int) -> str:
    """The table."""
    data = DatasetSettings(seed=SEED, scenes=LEARNED, degradations=1, rows=points, cols=points)
    network = build(Settings(), data.wall, data.time)
    learned = drawn(network, data, LEARNED)
    judged = drawn(network, data.model_copy(update={"held_out": True, "seed": HELD_OUT_SEED}), JUDGED)
    body = []
    for what in ("nothing", "peak", "deviation"):
        levels = fitted(learned, judged, what)
        cells = []
        for kind in range(len(KINDS)):
            fit = NoiseFit(judged.level[judged.kind == kind], levels[judged.kind == kind])
            cells.append(f"{fit.r_squared:.3f}, {fit.bias:+.2f}, {fit.scatter:.3f}")
        body.append([what, *cells])
    return table([f"{points} x {points}, told", *KINDS], body)


if __name__ == "__main__":
    print(main(int(sys.argv[1]) if len(sys.argv) > 1 else 16))

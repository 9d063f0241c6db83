"""Fits NANO's refinement: `python -m nlos.recon.training.refinement VERB FOLDER [FOLDER ...]`.

`collect` lets NANO see simulated scans (`refinement_set.py`), `learn` fits the network to them, `judge` says what it
gains on scans of kinds that neither ever saw, `ship` writes recon/weights/nano.refinement. Of fits in several folders
the mean of the weights is taken, which is better than each (Wortsman et al., ICML 2022). After a change of NANO's
weights: all of them, in new folders. `--share` of what the network changes in brightness is taken: scenes that it did
not learn from are a little better off with less of it than those that it did (decision 383).
"""

import argparse
import json
import os
from collections.abc import Sequence
from pathlib import Path

import torch

from nlos.recon.layers.refinement import BRIGHTNESS, Correction
from nlos.recon.refined import REFINEMENT
from nlos.recon.training.refinement_fit import fit, judge
from nlos.recon.training.refinement_set import TEST, TRAINING, all_held, hold
from nlos.recon.weights.files import OWN_FOLDER, put_weights, read_weights, save, sha256_of

DRAFT = "refinement.safetensors"


def draft(folders: Sequence[Path], share: float = 1.0) -> Correction:
    """What was fitted in `folders`, the mean of the weights, with `share` of its changes of brightness. Raises
    WeightsError."""
    fitted = [read_weights(folder / DRAFT).tensors for folder in folders]
    correction = Correction()
    mean = {name: sum((each[name] for each in fitted), torch.zeros(())) / len(fitted) for name in fitted[0]}
    put_weights(correction, mean, str(folders[0] / DRAFT))
    with torch.no_grad():
        for of_head in correction.network.head.parameters():
            of_head[BRIGHTNESS] *= share
    return correction.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verb", choices=["collect", "learn", "judge", "ship"])
    parser.add_argument("folders", type=Path, nargs="+", metavar="FOLDER")
    parser.add_argument("--part", default=TRAINING, choices=[TRAINING, TEST])
    parser.add_argument("--scans", type=int, default=2000)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--share", type=float, default=1.0)
    said = parser.parse_args()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    folder = said.folders[0]
    path = folder / DRAFT
    if said.verb == "collect":
        for index in range(said.scans):
            hold(said.part, index, folder)
    elif said.verb == "learn":
        begun = draft([folder]) if path.exists() else None
        correction = fit(all_held(TRAINING, folder), said.minutes, begun)
        save(path, correction.state_dict(), {"method": "refinement of nano"})
    elif said.verb == "judge":
        print(json.dumps(judge(draft(said.folders, said.share), all_held(TEST, folder))))
    else:
        shipped = draft(said.folders, said.share)
        gained = judge(shipped, all_held(TEST, folder))
        about = {"method": "refinement of nano", "of": sha256_of("nano"), "gained": gained, "share": said.share}
        save(OWN_FOLDER / REFINEMENT, {k: x.half() for k, x in shipped.state_dict().items()}, about)


if __name__ == "__main__":
    main()

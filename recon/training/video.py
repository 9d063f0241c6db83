"""Fits the network for films to NANO's pictures: `python -m nlos.recon.training.video VERB FOLDER`.

`collect` lets NANO see simulated films (`video_set.py`), `learn` fits the network to them, `judge` says what it gains
on films of kinds that neither ever saw, `ship` writes recon/weights/nano.video. After a change
of NANO's weights: all of them, in a new folder.
"""

import argparse
import json
import os
from pathlib import Path

import torch

from nlos.recon.film_network import VIDEO
from nlos.recon.layers.film_network import FilmNetwork
from nlos.recon.training.video_fit import DRAFT, fit, judge
from nlos.recon.training.video_set import TEST, TRAINING, all_held, hold
from nlos.recon.weights.files import OWN_FOLDER, put_weights, read_weights, save, sha256_of


def draft(folder: Path) -> FilmNetwork:
    """What was fitted in `folder`. Raises WeightsError."""
    network = FilmNetwork()
    put_weights(network, read_weights(folder / DRAFT).tensors, str(folder / DRAFT))
    return network.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verb", choices=["collect", "learn", "judge", "ship"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--part", default=TRAINING, choices=[TRAINING, TEST])
    parser.add_argument("--films", type=int, nargs="+", default=[0, 600], metavar="N", help="first, last and step")
    parser.add_argument("--minutes", type=float, default=60.0)
    said = parser.parse_args()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    folder = said.folder
    if said.verb == "collect":
        for index in range(*said.films):
            hold(said.part, index, folder)
    elif said.verb == "learn":
        begun = draft(folder) if (folder / DRAFT).exists() else None
        network = fit(folder, said.minutes, begun)
        save(folder / DRAFT, network.state_dict(), {"method": "network for films of nano"})
    elif said.verb == "judge":
        print(json.dumps(judge(draft(folder), list(all_held(TEST, folder)))))
    else:
        gained = judge(draft(folder), list(all_held(TEST, folder)))
        about = {"method": "network for films of nano", "of": sha256_of("nano"), "gained": gained}
        save(OWN_FOLDER / VIDEO, {k: x.half() for k, x in draft(folder).state_dict().items()}, about)


if __name__ == "__main__":
    main()

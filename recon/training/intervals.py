"""Trains and calibrates NANO's intervals: `python -m nlos.recon.training.intervals VERB FOLDER`.

`collect` lets NANO see simulated scans (`interval_set.py`). `train` fits the head to those of the kinds of scene that
NANO was trained on and of some that it never saw: only there does it fail as it does in the world. Where the folder has
a head, it is fitted further. `calibrate` conformalises on scans of the other kinds, which neither ever saw
(Romano et al., NeurIPS 2019), and writes recon/weights/nano.intervals. After a change of NANO's weights or of its
refinement all of it, in a new folder; what ships was made by

    collect FOLDER --part training --scans 150
    collect FOLDER --part calibration --scans 250
    train FOLDER --steps 1000
    collect FOLDER --part calibration --scans 360
    collect FOLDER --part slow_calibration --scans 90
    calibrate FOLDER

which takes about half an hour of one core, `train` from the head of before, put there as head.safetensors.
"""

import argparse
import json
import os
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import torch

from nlos.recon.intervals import CALIBRATED, head_in
from nlos.recon.layers.interval_head import IntervalHead
from nlos.recon.refined import REFINEMENT
from nlos.recon.training.interval_calibration import calibrate, error_line, judge
from nlos.recon.training.interval_fit import fit
from nlos.recon.training.interval_set import CALIBRATION, SEEDS, SLOW_CALIBRATION, TRAINING, Judged, all_judged, judged
from nlos.recon.weights.files import OWN_FOLDER, put_weights, read_weights, save, sha256_of

DRAFT = "head.safetensors"
SEEN = {"cages", "stars", "shelves"}
"""The kinds that NANO never saw and the head does: where NANO fails most."""


def kinds_of(made: Judged) -> set[str]:
    return set(str(made.about["kind"]).split("+"))


def fitted_to(folder: Path) -> Iterator[Judged]:
    """What the head is fitted to."""
    yield from all_judged(TRAINING, folder)
    yield from (made for made in all_judged(CALIBRATION, folder) if kinds_of(made) <= SEEN)


def never_seen(part: str, folder: Path) -> Iterator[Judged]:
    """Scans of a part with a kind that neither NANO nor the head was fitted to."""
    yield from (made for made in all_judged(part, folder) if not kinds_of(made) <= SEEN)


def to_calibrate_on(folder: Path) -> Iterator[Judged]:
    """What the head is calibrated on."""
    yield from never_seen(CALIBRATION, folder)
    yield from never_seen(SLOW_CALIBRATION, folder)


def save_draft(head: IntervalHead, folder: Path) -> None:
    """A head that is trained and not yet calibrated, beside the scans that it was trained on."""
    save(folder / DRAFT, head.state_dict(), {"method": "intervals of nano, not calibrated"})


def head_to_calibrate(folder: Path) -> IntervalHead:
    """The draft in `folder`; without one the head that ships, for NANO's new weights. Raises WeightsError."""
    path = folder / DRAFT
    if not path.exists():
        return head_in(OWN_FOLDER / CALIBRATED).network
    head = IntervalHead()
    put_weights(head, read_weights(path).tensors, str(path))
    return head.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verb", choices=["collect", "train", "calibrate", "judge"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--part", default=CALIBRATION, choices=list(SEEDS))
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--steps", type=int, default=3000)
    said = parser.parse_args()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    if said.verb == "collect":
        for index in range(said.scans):
            judged(said.part, index, said.folder)
        return
    if said.verb == "train":
        begun = head_to_calibrate(said.folder) if (said.folder / DRAFT).exists() else None
        save_draft(fit(fitted_to(said.folder), said.steps, begun), said.folder)
        return
    head = head_to_calibrate(said.folder)
    calibration = calibrate(head, to_calibrate_on(said.folder))
    print(json.dumps(judge(head, never_seen(said.part, said.folder), calibration)).replace("],", "],\n"))
    if said.verb == "calibrate":
        line = error_line(head, calibration, to_calibrate_on(said.folder))
        about = {
            "method": "intervals of nano", "calibration": calibration.as_json(), "error": asdict(line),
            "of": sha256_of("nano"), "refinement": sha256_of(str(OWN_FOLDER / REFINEMENT)),
        }  # fmt: skip
        save(OWN_FOLDER / CALIBRATED, {name: x.half() for name, x in head.state_dict().items()}, about)


if __name__ == "__main__":
    main()

"""Of a scan that is resumed: the picture of what it held, with which the next ones are compared."""

from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.calibration.errors import CalibrationError
from nlos.live.gathered import nothing_yet
from nlos.recon.errors import NO_PICTURE
from nlos.response import ResponseWanted

if TYPE_CHECKING:
    from nlos.recon.live import LivePicture, LiveReconstruction


def picture_before(
    run: Path, samples: int, live: "LiveReconstruction", constants: Path | None, response: ResponseWanted
) -> "LivePicture | None":
    """Of the first `samples` samples of a recording; from now on `live` knows it. None where there is none."""
    with suppress(InvalidData, StorageError, OSError, CalibrationError, *NO_PICTURE), open_checked(run) as recording:
        held = nothing_yet(recording, constants, response, adds_up=False, say=lambda said: None)
        for sample in islice(recording.samples(), samples):
            held.add(sample)
        known = held.calibrated(whole=False)
        return live.update(known.transient, known.samples, known.falloff)
    return None

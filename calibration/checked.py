"""Constants and impulse responses from anywhere: read by a child first, so that a damaged file stops nobody."""

from collections.abc import Mapping
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.isolated import check_isolated, one_reader
from nlos.calibration.constants import BenchConstants, load, load_response, newest_that_fits
from nlos.calibration.impulse_response import ImpulseResponse

_CONSTANTS, _RESPONSE = "nlos.calibration.constants:load", "nlos.calibration.constants:load_response"


def load_checked(path: Path) -> BenchConstants:
    """As `constants.load`."""
    check_isolated(path, _CONSTANTS)
    return load(path)


def response_checked(path: Path) -> ImpulseResponse:
    """As `constants.load_response`."""
    check_isolated(path, _RESPONSE)
    return load_response(path)


def newest_checked(folder: Path, devices: Mapping[str, str], bin_width_s: float | None = None) -> Path | None:
    """As `constants.newest_that_fits`, of the files in `folder`."""
    sound = []
    with one_reader() as reader:
        for path in sorted(folder.glob("*.h5")):
            try:
                reader.check(path, _CONSTANTS)
            except InvalidData:
                continue
            sound.append(path)
    return newest_that_fits(sound, devices, bin_width_s)

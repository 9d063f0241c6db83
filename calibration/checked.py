"""Constants and impulse responses from anywhere: read by a child first, so that a damaged file stops nobody."""

from datetime import UTC, datetime
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.isolated import check_isolated, one_reader
from nlos.calibration.constants import BenchConstants, load, load_response
from nlos.calibration.errors import CalibrationError
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


def measured_at(constants: BenchConstants) -> datetime:
    """When they were measured; a time without a zone is UTC, as its name says. Raises `ValueError` where it is none."""
    time = datetime.fromisoformat(constants.measured_utc)
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def all_checked(folder: Path) -> list[tuple[Path, BenchConstants]]:
    """Every constants file of `folder`, the newest measured first; what cannot be read is passed over."""
    found: list[tuple[datetime, Path, BenchConstants]] = []
    with one_reader():
        for path in sorted(folder.glob("*.h5")):
            try:
                constants = load_checked(path)
                found.append((measured_at(constants), path, constants))
            except (InvalidData, CalibrationError, ValueError, OSError):
                continue
    return [(path, constants) for _, path, constants in sorted(found, key=lambda each: each[:2], reverse=True)]

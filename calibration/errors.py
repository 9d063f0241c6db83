"""What can be wrong with raw counts and with constants; every message names the point, the reason and the way out."""

from nlos.acquisition import errors


class CalibrationError(ValueError):
    """Anything that calibration refuses to do."""


class InvalidData(CalibrationError, errors.InvalidData):
    """Counts or constants that no correction may be computed from. Nothing was changed, nothing was written."""


class NoDirectPeak(InvalidData):
    """The direct reflection cannot be found, so neither time zero nor distance is known."""


class ShutterClosed(NoDirectPeak):
    """Only dark counts arrived: the scan was taken with the light off."""


class NothingBehind(InvalidData):
    """The record ends with the direct light: no hidden scene can be in it."""


class SaturatedBins(InvalidData):
    """A bin reached the counter's limit: how many photons it stands for is not known."""


class ForeignConstants(InvalidData):
    """The constants were measured with another device, time axis or wall than the data."""


class StaleConstants(ForeignConstants):
    """The bench has changed since its constants were measured."""


class PoorCalibration(InvalidData):
    """The constants are worse than their own limits and are not saved."""

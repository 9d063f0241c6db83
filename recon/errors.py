"""What can go wrong between counts and a picture: the data, the settings, or the reconstruction."""

from nlos.acquisition.errors import InvalidData

__all__ = ["NO_PICTURE", "InvalidData", "InvalidSettings", "NoLight", "ReconError", "ReconstructionFailed"]
# `InvalidData` is the one of files and arrays, and calibration's derives from it: whoever catches it has them all.


class ReconError(Exception):
    """Base of what a method or its settings are to blame for."""


NO_PICTURE = (InvalidData, ReconError)
"""All that a reconstruction raises on purpose."""


class ReconstructionFailed(ReconError):
    """The data are fine and the reconstruction is not: too little memory, a method that cannot take this geometry."""


class NoLight(InvalidData):
    """Counts that hold no light above what was subtracted."""


class InvalidSettings(ReconError, ValueError):
    """The method or one of its settings does not exist, or has a value it cannot have."""

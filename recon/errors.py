"""What can go wrong between counts and a picture: the data, the settings, or the reconstruction."""


class ReconError(Exception):
    """Base of all."""


class InvalidData(ReconError):
    """The data cannot be reconstructed by anyone: not finite, negative, empty, or not of the shape they claim."""


class ReconstructionFailed(ReconError):
    """The data are fine and the reconstruction is not: too little memory, a method that cannot take this geometry."""


class NoLight(InvalidData):
    """Counts that hold no light above what was subtracted."""


class InvalidSettings(ReconError, ValueError):
    """The method or one of its settings does not exist, or has a value it cannot have."""

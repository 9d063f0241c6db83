"""What can go wrong between counts and a picture: the data, or the reconstruction of them."""


class ReconError(Exception):
    """Base of both."""


class InvalidData(ReconError):
    """The data cannot be reconstructed by anyone: not finite, negative, empty, or not of the shape they claim."""


class ReconstructionFailed(ReconError):
    """The data are fine and the reconstruction is not: too little memory, a method that cannot take this geometry."""

"""What can be wrong with data and storage, as opposed to devices."""


class InvalidData(ValueError):
    """A file or an array does not hold what it must; the message names file, place and reason."""


class StorageError(OSError):
    """The disk is full, a file may not be written, or it would be overwritten."""


class PlanRefused(ValueError):
    """A scan file asks for what wall, pattern and exposure cannot give together; the message says what to change."""

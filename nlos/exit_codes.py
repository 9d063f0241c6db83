"""Every way in which a command can end, as the number it exits with."""

import errno
from enum import IntEnum


class ExitCode(IntEnum):
    """See the command line's contract in the README."""

    DONE = 0
    BUG = 1
    USAGE = 2
    DEVICE = 3
    REFUSED = 4
    ALARM = 5
    STORAGE = 6
    DATA = 7
    RECONSTRUCTION = 8
    DEADLINE = 9
    INTERRUPTED = 130
    TERMINATED = 143


class UsageError(ValueError):
    """The command was called in a way that cannot work; the message says what to change."""


class Stopped(Exception):
    """The command ended early for a reason that it has explained itself."""

    def __init__(self, code: ExitCode, message: str) -> None:
        self.code = code
        super().__init__(message)


def exit_code(error: BaseException) -> ExitCode:
    """The number for an error. What no room foresaw is a bug."""
    from acquisition import errors as acquisition
    from calibration import errors as calibration
    from configs.load import ConfigError
    from drivers import errors as drivers
    from recon import errors as recon

    table: list[tuple[type[BaseException] | tuple[type[BaseException], ...], ExitCode]] = [
        (KeyboardInterrupt, ExitCode.INTERRUPTED),
        ((ConfigError, UsageError, FileNotFoundError, IsADirectoryError), ExitCode.USAGE),
        ((drivers.LimitError, drivers.SafetyTrip), ExitCode.REFUSED),
        (drivers.DeviceTimeout, ExitCode.DEADLINE),
        (drivers.DeviceError, ExitCode.DEVICE),
        ((acquisition.StorageError, FileExistsError), ExitCode.STORAGE),
        ((acquisition.InvalidData, calibration.InvalidData, recon.InvalidData), ExitCode.DATA),
        (recon.ReconstructionFailed, ExitCode.RECONSTRUCTION),
    ]
    if isinstance(error, Stopped):
        return error.code
    for kinds, code in table:
        if isinstance(error, kinds):
            return code
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO):
        return ExitCode.STORAGE
    if isinstance(error, PermissionError):
        return ExitCode.STORAGE
    return ExitCode.BUG

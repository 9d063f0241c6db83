"""Every way in which a command can end, as the number it exits with."""

import errno
import re
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


EXTRAS = {
    "torch": "recon", "safetensors": "recon", "zmq": "live",
    "distributed": "cluster",
}  # fmt: skip
"""Package that only some verbs need -> the extra that brings it."""
ALWAYS = {
    "serial": "pyserial", "usb": "pyusb", "PIL": "pillow", "h5py": "h5py", "matplotlib": "matplotlib", "scipy": "scipy",
    "ptufile": "ptufile", "sdtfile": "sdtfile",
}  # fmt: skip
"""Package that every installation has -> its name where it is installed from; missing where the program's folder was
put on Python's path instead."""


_OF_STORAGE = {
    getattr(errno, name, None)
    for name in (
        "ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EIO", "EREMOTEIO", "ESTALE", "ENOTCONN", "EHOSTDOWN", "EMFILE", "ENFILE",
        "EXDEV", "EBUSY", "ENODEV", "ENOTSUP", "EOPNOTSUPP", "ENOLCK",
    )
} - {None}  # fmt: skip
"""What disks say, network shares that are gone or cannot do what local disks do, and a system that opens no more
files."""
_LIBRARY = re.compile(r"\.so\b|^dlopen|^DLL load failed")
"""Of an `ImportError`: what Linux, macOS and Windows say of a compiled library."""


class UsageError(ValueError):
    """The command was called in a way that cannot work; the message says what to change."""


class Stopped(Exception):
    """The command ended early for a reason that it has explained itself."""

    def __init__(self, code: ExitCode, message: str, *, names_files: bool = False) -> None:
        """`names_files`: the message says itself of which files it is."""
        self.code, self.names_files = code, names_files
        super().__init__(message)


def exit_code(error: BaseException) -> ExitCode:
    """The number for an error. What no room foresaw is a bug."""
    import nlos.acquisition.errors
    import nlos.drivers.errors
    import nlos.recon.errors
    from nlos.configs.load import ConfigError
    from nlos.configs.read_whole import ConfigNotRead

    table: list[tuple[type[BaseException] | tuple[type[BaseException], ...], ExitCode]] = [
        (KeyboardInterrupt, ExitCode.INTERRUPTED),
        (
            (
                ConfigError,
                UsageError,
                nlos.acquisition.errors.PlanRefused,
                nlos.recon.errors.InvalidSettings,
                FileNotFoundError,
                IsADirectoryError,
            ),
            ExitCode.USAGE,
        ),
        ((nlos.drivers.errors.LimitError, nlos.drivers.errors.SafetyTrip), ExitCode.REFUSED),
        ((nlos.drivers.errors.DeviceTimeout, TimeoutError), ExitCode.DEADLINE),
        (nlos.drivers.errors.DeviceError, ExitCode.DEVICE),
        ((nlos.acquisition.errors.StorageError, ConfigNotRead, FileExistsError), ExitCode.STORAGE),
        (nlos.acquisition.errors.InvalidData, ExitCode.DATA),
        ((nlos.recon.errors.ReconstructionFailed, MemoryError), ExitCode.RECONSTRUCTION),
    ]
    if isinstance(error, Stopped):
        return error.code
    if missing_package(error) is not None:
        return ExitCode.USAGE
    for kinds, code in table:
        if isinstance(error, kinds):
            return code
    if isinstance(error, OSError) and error.errno in (errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP):
        return ExitCode.USAGE
    if isinstance(error, OSError) and error.errno in _OF_STORAGE:
        return ExitCode.STORAGE
    if isinstance(error, PermissionError):
        return ExitCode.STORAGE
    return ExitCode.BUG


def missing_package(error: BaseException) -> str | None:
    """What to install, where a command needs a package that is not there; what to do about one that is there and cannot
    be loaded."""
    if type(error) is ImportError and _LIBRARY.search(error.msg or ""):
        return (
            f"an installed library cannot be loaded ({error.msg}). Allow more memory (ulimit -v), install it where "
            "programs may be run from, or install it again, for this computer and this Python."
        )
    if not isinstance(error, ModuleNotFoundError) or error.name is None:
        return None
    package = error.name.partition(".")[0]
    if package in ALWAYS:
        return (
            f"this needs {ALWAYS[package]}, which is installed with nlos and is not there. Install nlos itself, with "
            f"pip, rather than put its folder on the path; or: pip install {ALWAYS[package]}"
        )
    if package not in EXTRAS:
        return None
    return f"this needs {package}, which is not installed. Install it with: pip install 'nlos[{EXTRAS[package]}]'"

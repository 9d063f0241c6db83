"""What a scan needs beside the bench: software, disk, and what the bench file says of cables."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nlos.cli.devices import Expected, expectations
from nlos.doctor.findings import Finding, failed, passed, warned
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.cable_levels import level_conflicts
from nlos.drivers.errors import DeviceNotFound
from nlos.drivers.link.usb_search import available_instruments
from nlos.recon.methods import PLAIN, torch_is_installed

_FREE_GB = 5.0


def software() -> Iterator[Finding]:
    """Interpreter, packages, libusb."""
    found = ".".join(map(str, sys.version_info[:3]))
    yield passed("software", f"Python {found}, {versions('nlos', 'numpy', 'h5py', 'pyserial', 'pyusb')}")
    if not torch_is_installed():
        said = f"torch is not installed: scanning works, and of the methods {' and '.join(sorted(PLAIN))}"
        yield warned("software", said, "pip install 'nlos[recon]'")
    else:
        yield passed("software", versions("torch"))
    try:
        available_instruments()
    except DeviceNotFound as error:
        yield warned("software", f"{error.what} Only simulated USB instruments can be opened", error.remedy)


def disk(folder: Path) -> Iterator[Finding]:
    """Room for recordings, and whether what is written comes back."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    if free_gb < _FREE_GB:
        yield warned("disk", f"{free_gb:.1f} GB free in {folder.resolve()}", "Make room, or use -o elsewhere.")
    else:
        yield passed("disk", f"{free_gb:.0f} GB free in {folder.resolve()}")
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            data = os.urandom(1 << 20)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            file.seek(0)
            came_back = file.read() == data
    except OSError as error:
        yield failed("disk", f"nothing can be written here ({error})", "Choose another folder.")
        return
    if not came_back:
        yield failed("disk", "what was written did not come back", "Do not record here; check the disk.")


def levels(settings: BenchSettings) -> Iterator[Finding]:
    """Cables that carry more, or less, than the input at their end takes. Asked before anything is opened."""
    if settings.simulated:
        return
    for conflict in level_conflicts(settings.mirror, settings.counter):
        yield warned("levels", conflict.what, conflict.remedy)


def absent(settings: BenchSettings) -> list[Expected]:
    """What a real bench's file names and is not there, or is another one."""
    if settings.simulated:
        return []
    return [item for item in expectations(settings) if not item.found]


def versions(*packages: str) -> str:
    """Names and versions of installed packages."""
    found = []
    for package in packages:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} (not installed)")
    return ", ".join(found)

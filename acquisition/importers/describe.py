"""What is in a file that is not a scan: names and shapes of an HDF5 file, headers of PTU and SDT files."""

from pathlib import Path

import h5py
import ptufile

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.becker_hickl import contents_of_sdt, is_sdt
from nlos.acquisition.importers.untrusted_hdf5 import open_hdf5

_PTU_TAGS = (
    "File_CreatingTime",
    "File_Comment",
    "CreatorSW_Name",
    "HW_Type",
    "Measurement_Mode",
    "Measurement_SubMode",
    "MeasDesc_Resolution",
    "MeasDesc_GlobalResolution",
    "MeasDesc_AcquisitionTime",
    "TTResult_SyncRate",
    "TTResult_NumberOfRecords",
)


def describe(path: Path) -> dict[str, object]:
    """Contents by name, for people; empty where the format is not known. Raises `InvalidData` for damaged files."""
    with path.open("rb") as file:
        magic = file.read(8)
    if magic == b"\x89HDF\r\n\x1a\n":
        return _hdf5(path)
    if magic[:6] == b"PQTTTR":
        return _ptu(path)
    if is_sdt(path):
        return contents_of_sdt(path)
    return {}


def _hdf5(path: Path) -> dict[str, object]:
    with open_hdf5(path) as file:
        found: dict[str, object] = {"format": "HDF5"}
        for name in sorted(file.keys())[:32]:
            item = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
            found[name] = f"{item.dtype} {item.shape}" if isinstance(item, h5py.Dataset) else "a group or a link"
        return found


def _ptu(path: Path) -> dict[str, object]:
    try:
        with ptufile.PtuFile(path) as ptu:
            tags = {key: ptu.tags[key] for key in _PTU_TAGS if key in ptu.tags}
    except (ptufile.PqFileError, ValueError, LookupError, TypeError, OverflowError, EOFError) as error:
        raise InvalidData(f"{path}: not a readable PTU file ({error})") from error
    return {"format": f"PTU, T{tags.get('Measurement_Mode', '?')} mode", **tags}

"""NPZ: every array of a scan under its own name, and nothing lost."""

from pathlib import Path

import numpy as np

from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.scan_facts import facts_of


def write_npz(scan: ScanArrays, path: Path) -> list[str]:
    """Writes all of `facts_of`. Returns what the format cannot hold."""
    with path.open("wb") as file:
        np.savez_compressed(file, **facts_of(scan))
    return ["the event log, the settings and the devices stay in the recording"]

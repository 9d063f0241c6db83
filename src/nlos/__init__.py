"""Confocal non-line-of-sight imaging: from galvo mirrors and single photons to what is behind the corner.

    import nlos

    picture = nlos.reconstruct(histograms, wall=(2.0, 2.0), bin_width=32e-12)   # NumPy [H, W, T]
    picture = nlos.reconstruct(nlos.load("run.h5"), method="nano")
    picture.albedo, picture.depth_m, picture.volume
    with nlos.open_bench("lab.yaml") as bench:
        for sample in nlos.scan("demo", bench):
            ...

Importing this loads neither torch nor h5py; each function loads what it needs when it is called.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nlos.version import __version__

if TYPE_CHECKING:
    from nlos.acquiring import open_bench, scan
    from nlos.catalogue import MethodInfo, methods
    from nlos.picture import Picture
    from nlos.reconstructing import reconstruct
    from nlos.scan_data import Scan, load

__all__ = ["MethodInfo", "Picture", "Scan", "__version__", "load", "methods", "open_bench", "reconstruct", "scan"]

_WHERE = {
    "MethodInfo": "catalogue",
    "Picture": "picture",
    "Scan": "scan_data",
    "load": "scan_data",
    "methods": "catalogue",
    "open_bench": "acquiring",
    "reconstruct": "reconstructing",
    "scan": "acquiring",
}


if not TYPE_CHECKING:  # which knows the names above, and would take any other for one

    def __getattr__(name: str) -> Any:
        """Loads a function of the API when it is first asked for."""
        if name not in _WHERE:
            raise AttributeError(f"module 'nlos' has no attribute '{name}'; it offers {', '.join(sorted(_WHERE))}")
        from nlos.whole_imports import whole_imports

        with whole_imports():
            value = getattr(import_module(f"nlos.{_WHERE[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted(__all__)

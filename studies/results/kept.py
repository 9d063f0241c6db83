"""Measurements that are kept until something that they depend on changes: weights, code or data."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.recon.weights.files import OWN_FOLDER, place_of

FOLDER = Path("runs/results")
EQUAL = {"lfe": "nano_4000", "nlost": "nano_4000", "unet": "nano_6500"}
"""Weights of a NANO that has seen as many samples as each rival."""
TREATED_ALIKE = {"lfe_4000": "nano_4000_once", "nlost_4000": "nano_4000_once", "unet_4000": "nano_4000_once"}
"""The same, by NANO's losses, one sample a step, seen once: what targets are judged by."""
BASE = dict.fromkeys(EQUAL.values(), "nano") | {
    "lfe_4000": "lfe",
    "unet_4000": "unet",
    "nlost_4000": "nlost",
    "nano_4000_once": "nano",
}
"""The method of weights that are not called like it."""
WEIGHTS_OF = {"nano_4000_once": "nano_4000"}
"""The weights of what is called otherwise: here the same, without the mean over mirror images."""
CODE = OWN_FOLDER.parent  # recon/


@dataclass(frozen=True)
class Kept:
    """Plain figures, pictures by name, and where a drawing of them lies."""

    figures: Any
    arrays: Mapping[str, npt.NDArray[np.float32]]
    drawing: Path


Measure = Callable[[Path], tuple[Any, Mapping[str, npt.NDArray[np.float32]]]]
"""Draws to the path if it has something to draw; returns figures (plain values) and arrays."""


def kept(name: str, depends: Mapping[str, Any], measure: Measure, folder: Path = FOLDER) -> Kept:
    """What `measure` returned when `depends` was last like this, or what it returns now."""
    digest = hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()[:16]
    stem = folder / f"{name.replace(':', '-')}-{digest}"
    figures, arrays, drawing = (stem.with_suffix(suffix) for suffix in (".json", ".npz", ".png"))
    if not figures.exists():
        folder.mkdir(parents=True, exist_ok=True)
        found, pictures = measure(drawing)
        np.savez_compressed(arrays, **{key: np.asarray(x, np.float16) for key, x in pictures.items()})  # type: ignore[arg-type]
        partial = stem.with_suffix(".partial")
        partial.write_text(json.dumps(found, indent=1), encoding="utf-8")
        partial.replace(figures)
    with np.load(arrays) as held:
        shown = {key: held[key].astype(np.float32) for key in held.files}
    return Kept(json.loads(figures.read_text(encoding="utf-8")), shown, drawing)


def of_files(paths: Iterable[Path]) -> str:
    """One digest of the contents of files."""
    whole = hashlib.sha256()
    for path in sorted(paths):
        whole.update(path.name.encode() + path.read_bytes())
    return whole.hexdigest()[:16]


def of_code(method: str) -> str:
    """A digest of the code that a method runs."""
    folders = ("layers", "transport") if weights_path(method).exists() else ("transport",)
    shared = ("physics.py", "noise.py", "front_view.py", "reconstruct.py", "metrics.py", "subsets.py", "refined.py")
    own = (f"methods/{BASE.get(method, method)}.py", *shared)
    chosen = {name: digest for name, digest in SOURCES.items() if name.startswith(folders) or name in own}
    return hashlib.sha256(json.dumps(chosen, sort_keys=True).encode()).hexdigest()[:16]


def weights_path(method: str) -> Path:
    """Where the weights of a learned method lie, there or not."""
    return place_of(WEIGHTS_OF.get(method, method))


def of_method(method: str) -> dict[str, str]:
    """What a reconstruction by this method depends on, beside its input."""
    path = weights_path(method)
    files = [each for each in (path, path.with_suffix(".refinement"), path.with_suffix(".noise")) if each.exists()]
    return {"code": of_code(method), "weights": of_files(files) if files else "none"}


SOURCES = {path.relative_to(CODE).as_posix(): of_files([path]) for path in CODE.rglob("*.py")}
"""Digests of the code as this process loaded it, whatever is edited while it runs."""

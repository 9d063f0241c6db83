"""Weights as safetensors with their settings inside: found, read, put into a network; nothing that is read can run.

Files appear whole or not at all.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load as from_bytes
from safetensors.torch import save as as_bytes
from torch import nn

from nlos.acquisition.recording.disk_refusal import disk_refusal, told_of
from nlos.recon.errors import InvalidSettings
from nlos.recon.file_mode import readable_as_its_folder
from nlos.recon.weights.foreign import SUFFIXES, ForeignWeightsError, read_foreign

OWN_FOLDER = Path(__file__).resolve().parent
STUDIES = OWN_FOLDER.parents[1] / "studies" / "weights"
"""Weights that only the pages about results need: in a clone of the repository, not in the package."""
SHOWN = 5
MOST_HEADER_BYTES = 100_000_000
"""As safetensors itself has it."""
AnyModule = TypeVar("AnyModule", bound=nn.Module)


class WeightsError(InvalidSettings):
    """Weights that cannot be used: not there, unreadable, or not those of this network."""


@dataclass(frozen=True)
class Weights:
    """Named tensors and what was said about them when they were saved."""

    tensors: dict[str, torch.Tensor]
    about: dict[str, Any]


def find_weights(name: str) -> Path:
    """The file that `name` means: a path, or a name in recon/weights (in a clone also in studies/weights).

    Raises WeightsError.
    """
    for path in (Path(name), OWN_FOLDER / f"{name}.safetensors", STUDIES / f"{name}.safetensors"):
        if path.is_file():
            return path
    known = ", ".join(sorted(path.stem for path in OWN_FOLDER.glob("*.safetensors"))) or "none"
    raise WeightsError(
        f"no weights {name!r}: no such file, and none of that name come with the package ({known}). Those of rivals "
        "are in the repository, in studies/weights; give the file as `weights`, or train it with `nlos train`."
    )


def place_of(name: str) -> Path:
    """Where the weights of that name are, or would be, in a clone of the repository."""
    studied = STUDIES / f"{name}.safetensors"
    return studied if studied.is_file() else OWN_FOLDER / f"{name}.safetensors"


def read_weights(path: Path) -> Weights:
    """Raises WeightsError if the file is not a whole safetensors file (or one of PyTorch's own, `foreign_weights`),
    `StorageError` where the disk does not give it."""
    if path.suffix in SUFFIXES:
        try:
            return Weights(read_foreign(path), {})
        except ForeignWeightsError as error:
            raise WeightsError(str(error)) from error
    try:
        whole = path.read_bytes()  # safetensors maps files: one that is cut while it is read would end this process
        return Weights(from_bytes(whole), _about(_header(BytesIO(whole))))
    except KeyError as error:
        raise WeightsError(
            f"{path}: its numbers are of type {error.args[0]}, which safetensors knows and PyTorch does not read. Save "
            "them as F32."
        ) from error
    except (SafetensorError, OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def read_about(path: Path) -> dict[str, Any]:
    """What was said about weights when they were saved, without reading them. Raises WeightsError."""
    if path.suffix in SUFFIXES:
        return {}
    try:
        return _about(_header_of(path))
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def is_training_state(path: Path) -> bool:
    """Whether a file is what a training resumes from, and not its weights."""
    if path.suffix in SUFFIXES:
        return False
    try:
        return any(name.startswith("average/") for name in _header_of(path))
    except (OSError, ValueError):
        return False


def _header_of(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        return _header(file)


def _header(file: BinaryIO) -> dict[str, Any]:
    """What a safetensors file says of its tensors, by name, and of itself (`__metadata__`): JSON behind its length in
    8 bytes (github.com/huggingface/safetensors, "Format"). Raises ValueError."""
    length = int.from_bytes(file.read(8), "little")
    text = file.read(min(length, MOST_HEADER_BYTES))
    if not 0 < length <= len(text):
        raise ValueError("it is cut short, or of another kind")
    found = _from_json(text)
    if not isinstance(found, dict):
        raise ValueError("it is of another kind")
    return found


def _about(header: Mapping[str, Any]) -> dict[str, Any]:
    said = header.get("__metadata__")
    about = _from_json(str(said.get("about", "{}"))) if isinstance(said, dict) else {}
    return about if isinstance(about, dict) else {}


def _from_json(text: str | bytes) -> object:
    """Raises ValueError."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested beyond reading") from error


def _unreadable(path: Path, error: Exception) -> Exception:
    """What the disk does not give says nothing of the file."""
    return disk_refusal(path, error) or WeightsError(
        f"{path} is not a readable safetensors file ({error}). Copy or train it again."
    )


def refuse_training_state(path: Path) -> None:
    """Raises WeightsError for what a training resumes from."""
    if is_training_state(path):
        raise WeightsError(f"{path} is the state of a training. Use weights.safetensors, which lies beside it.")


def holds(name: str, prefix: str) -> bool:
    """Whether the weights `name` have parameters whose names begin with `prefix`. Raises WeightsError."""
    return any(tensor.startswith(prefix) for tensor in read_weights(find_weights(name)).tensors)


def load_weights(module: nn.Module, name: str) -> dict[str, Any]:
    """Put the weights `name` (see `find_weights`) into `module`; returns what is said about them.

    Raises WeightsError unless every parameter is there in its shape.
    """
    path = find_weights(name)
    refuse_training_state(path)
    weights = read_weights(path)
    put_weights(module, weights.tensors, str(path))
    return weights.about


def with_weights(module: AnyModule, name: str | None) -> AnyModule:
    """The module as it is; given a name, with these weights and for use instead of training. Raises WeightsError."""
    if name is not None:
        load_weights(module, name)
        module.eval()
    return module


def put_weights(module: nn.Module, tensors: Mapping[str, torch.Tensor], source: str) -> None:
    """Copy `tensors` into the parameters of the same names; WeightsError says what does not fit.

    Parameters whose names begin with one of the module's `added_later` may be missing, and stay as they were built.
    """
    own = dict(module.named_parameters())
    later = tuple(getattr(module, "added_later", ()))
    own = {name: parameter for name, parameter in own.items() if name in tensors or not name.startswith(later)}
    wrong = [f"{name} is missing" for name in own.keys() - tensors.keys()]
    wrong += [f"{name} is not of this network" for name in tensors.keys() - own.keys()]
    wrong += [
        f"{name} is {tuple(tensors[name].shape)}, not {tuple(own[name].shape)}"
        for name in own.keys() & tensors.keys()
        if tensors[name].shape != own[name].shape
    ]
    if wrong:
        shown = "; ".join(sorted(wrong)[:SHOWN]) + (f"; and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else "")
        raise WeightsError(f"{source}: {shown}. Use the settings that these weights were trained with.")
    with torch.no_grad():
        for name, parameter in own.items():
            parameter.copy_(tensors[name])


def put_part(module: nn.Module, prefix: str, name: str) -> None:
    """Put those of the weights `name` whose names begin with `prefix` into `module`. Raises WeightsError."""
    path = find_weights(name)
    tensors = read_weights(path).tensors
    put_weights(module, {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}, str(path))


def save(path: Path, tensors: Mapping[str, torch.Tensor], about: Mapping[str, Any]) -> None:
    """Write atomically: a reader, or a machine that loses power, finds the old file or the new one. Raises
    `StorageError` where the disk does not take it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    try:
        with told_of(path, partial):
            partial.write_bytes(as_bytes(plain, {"about": json.dumps(about)}))
            readable_as_its_folder(partial)
            with partial.open("rb+") as file:
                os.fsync(file.fileno())
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def goes_with(path: Path, weights: str) -> bool:
    """Whether what is in `path` was fitted to pictures made by these weights. Raises WeightsError."""
    return bool(read_about(path).get("of") == sha256_of(weights))


def sha256_of(weights: str) -> str:
    """SHA-256 of the file that `weights` means. Raises WeightsError, and `StorageError` where the disk does not give
    it."""
    path = find_weights(weights)
    try:
        now = path.stat()
        return _sha256(path, now.st_mtime_ns, now.st_size)
    except OSError as error:
        raise _unreadable(path, error) from error


@lru_cache(maxsize=16)
def _sha256(path: Path, mtime_ns: int, size: int) -> str:
    """Of a file as it was then: every picture says whose weights made it."""
    return hashlib.sha256(path.read_bytes()).hexdigest()

"""Weights in PyTorch's own format, from outside: read in a child process, and nothing but plain tensors comes back.

The child reads with `weights_only`, which builds tensors and runs nothing, under limits of memory, time and file size;
whatever a forged file does to that reader, it does it over there. Shapes are checked where tensors are put in place.
"""

import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from pickle import UnpicklingError

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from nlos.recon.errors import InvalidSettings

SUFFIXES = (".pt", ".pth", ".bin")
DEADLINE_S = 120.0
MEMORY_BYTES = 16 << 30
LARGEST_FILE_BYTES = 1 << 30
NESTED = ("state_dict", "model", "weights")


class ForeignWeightsError(InvalidSettings):
    """A file that cannot be read as plain named tensors."""


def read_foreign(path: Path) -> dict[str, torch.Tensor]:
    """The named tensors in `path`. Raises ForeignWeightsError, also where the child crashed or took too long."""
    with tempfile.TemporaryDirectory(prefix="nlos-weights-") as folder:
        plain = Path(folder) / "plain.safetensors"
        command = [sys.executable, "-P", "-m", __name__, str(path.absolute()), str(plain)]
        try:
            child = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise ForeignWeightsError(f"{path}: not read within {DEADLINE_S:g} s.") from error
        if child.returncode != 0:
            why = child.stderr.strip().splitlines()[-1:] if child.returncode == 1 else []
            raise ForeignWeightsError(
                f"{path}: {why[0] if why else 'the reader did not survive this file'}. "
                "Save the state_dict as safetensors where it was trained."
            )
        try:
            return load_file(plain)
        except (SafetensorError, OSError) as error:
            raise ForeignWeightsError(f"{path}: nothing could be read ({error}).") from error


def _tensors(held: object) -> dict[str, torch.Tensor]:
    """The state_dict in what a checkpoint holds. Raises ValueError where there is none."""
    for key in NESTED:
        if isinstance(held, dict) and isinstance(held.get(key), dict):
            held = held[key]
    if not isinstance(held, dict) or not held:
        raise ValueError(f"it holds {type(held).__name__}, not named tensors")
    for name, tensor in held.items():
        if not isinstance(name, str) or not isinstance(tensor, torch.Tensor):
            raise ValueError(f"{name!r} is {type(tensor).__name__}, not a tensor")
        if tensor.layout != torch.strided or not tensor.is_floating_point() or not bool(tensor.isfinite().all()):
            raise ValueError(f"{name} is not a dense tensor of finite numbers")
    return {name: tensor.detach().clone().contiguous() for name, tensor in held.items()}


def _child(source: str, destination: str) -> int:
    """Reads `source` and writes its tensors to `destination`; 0 if that went well."""
    if sys.platform != "win32":
        import resource

        for limit, value in ((resource.RLIMIT_AS, MEMORY_BYTES), (resource.RLIMIT_FSIZE, LARGEST_FILE_BYTES)):
            with suppress(ValueError):  # macOS takes none below what a process has been given already
                resource.setrlimit(limit, (value, value))
    try:
        save_file(_tensors(torch.load(source, map_location="cpu", weights_only=True)), destination)
    except (UnpicklingError, ValueError, RuntimeError, EOFError, OSError, KeyError, TypeError, AttributeError) as error:
        print(f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_child(*sys.argv[1:3]))

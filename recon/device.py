"""Where reconstruction runs: the processor, or a GPU that PyTorch sees."""

from importlib.util import find_spec

from nlos.recon.errors import InvalidSettings

DEVICES = ("cpu", "cuda")


def check_device(device: str) -> None:
    """Raises `InvalidSettings` for a device that does not exist or is not there."""
    if device not in DEVICES:
        raise InvalidSettings(f"--device {device}: {' or '.join(DEVICES)}")
    if device == "cpu":
        return
    if find_spec("torch") is None:
        raise InvalidSettings("--device cuda: needs PyTorch, which is not installed: pip install 'nlos[recon]'.")
    import torch

    if not torch.cuda.is_available():
        raise InvalidSettings(
            "--device cuda: PyTorch sees no GPU here. Leave --device out, or install PyTorch for CUDA."
        )

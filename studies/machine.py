"""What a timing was measured on, in words."""

import os
import platform
from pathlib import Path

import torch

CPUS = Path("/proc/cpuinfo")


def machine() -> str:
    """The processor's name and how many cores of it this machine has, and PyTorch's version."""
    return f"{_processor()}, {os.cpu_count()} virtual cores, PyTorch {torch.__version__}"


def _processor() -> str:
    """As Linux names it, elsewhere what Python knows."""
    if CPUS.exists():
        for line in CPUS.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()

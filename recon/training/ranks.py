"""Several processes that train one network: what they agree on, and the step that they take together."""

import math
import os
from dataclasses import dataclass

import torch
import torch.distributed as dist
from torch import nn


@dataclass(frozen=True)
class Place:
    """This process's number and how many there are."""

    rank: int = 0
    world: int = 1


def join() -> Place:
    """This process's place, once all know each other; the only one where none were started by torchrun."""
    if "RANK" not in os.environ:
        return Place()
    dist.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
    if torch.cuda.is_available():
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    return Place(dist.get_rank(), dist.get_world_size())


def everywhere(here: bool, world: int, device: str) -> bool:
    """Whether it is so in every process."""
    answer = torch.tensor(float(here), device=device)
    return bool(mean_of_all(answer, world) == 1)


def mean_of_all(x: torch.Tensor, world: int) -> torch.Tensor:
    """The mean over all processes."""
    if world > 1:
        dist.all_reduce(x)
        x /= world
    return x


def step_together(parameters: list[nn.Parameter], optimiser: torch.optim.Optimizer, clip: float, world: int) -> float:
    """Average the gradients of all processes, clip, step; a step that is not finite is skipped. Returns the norm."""
    if world > 1:
        flat = torch.cat([(p.grad if p.grad is not None else torch.zeros_like(p)).flatten() for p in parameters])
        mean_of_all(flat, world)
        start = 0
        for p in parameters:
            p.grad = torch.empty_like(p).copy_(flat[start : start + p.numel()].view(p.shape))
            start += p.numel()
    norm = float(nn.utils.clip_grad_norm_(parameters, clip))
    if math.isfinite(norm):
        optimiser.step()
    optimiser.zero_grad(set_to_none=True)
    return norm

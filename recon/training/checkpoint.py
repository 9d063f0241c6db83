"""What a training keeps beside its weights: the optimiser, shared parameters, the commit of the code.

A training state holds weights, their running mean, the optimiser and the place in the data; random numbers follow from
(seed, step) and need no storing.
"""

from collections.abc import Mapping

import torch
from torch import nn

from nlos.acquisition.recording.provenance import git_says


def share_parameters(source: nn.Module, target: nn.Module) -> nn.Module:
    """Makes `target` (built for another grid) use the very parameters of `source`; returns it."""
    for name, parameter in source.named_parameters():
        owner, _, leaf = name.rpartition(".")
        setattr(target.get_submodule(owner), leaf, parameter)
    return target


def optimiser_tensors(module: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, torch.Tensor]:
    """AdamW's state by parameter name."""
    return {
        f"optimiser/{name}/{key}": value
        for name, parameter in module.named_parameters()
        for key, value in optimiser.state.get(parameter, {}).items()
    }


def put_optimiser(module: nn.Module, optimiser: torch.optim.Optimizer, tensors: Mapping[str, torch.Tensor]) -> None:
    """The reverse of `optimiser_tensors`; layouts follow the parameters, so that the next step is bit-equal."""
    for name, parameter in module.named_parameters():
        prefix = f"optimiser/{name}/"
        for key in [key for key in tensors if key.startswith(prefix)]:
            value = tensors[key]
            if value.shape == parameter.shape:
                value = torch.empty_like(parameter, requires_grad=False).copy_(value)
            optimiser.state[parameter][key.removeprefix(prefix)] = value


def commit() -> str:
    """The commit of the code, with a + if it was changed since; "unknown" outside a repository."""
    return git_says("describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*") or "unknown"

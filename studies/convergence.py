"""Does algorithm 1 converge? Relative changes of its passes and iterations, and Lipschitz estimates of its parts.

`python -m studies.convergence FIGURE.png` measures on one simulated scan the weights that come with the program
and, where `make ablations` has trained them, networks whose passes were trained through.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor

from nlos.recon.layers.physical_unfolding import PhysicalUnfolding
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.dataset import collate, sample
from nlos.recon.training.train import WEIGHTS
from studies.ablations import SAMPLES, VALIDATION, WHOLE, folder_of, in_order

Map = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Contraction:
    """Local Lipschitz estimates, C_p C_B^K C_l, which theorem 2 of the paper asks to be below 1, and changes."""

    lifting: float  # B_l: features -> u^0
    projection: float  # B_p: u^K -> logits and features
    iterations: tuple[float, ...]  # I - dt S of each iteration, finest scale first
    whole_pass: float  # u^{s-1} -> u^s
    changes: tuple[float, ...]  # log10 |u^{k+1} - u^k| / |u^{k+1}| of each iteration

    @property
    def product(self) -> float:
        """The bound of the theorem for this network: every factor at its own estimate."""
        return self.lifting * self.projection * float(torch.tensor(self.iterations).prod())


def lipschitz(function: Map, at: Tensor, steps: int = 12, seed: int = 0) -> float:
    """The largest singular value of the Jacobian of `function` at `at`, by power iteration on J^T J."""
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(at.shape, generator=generator)
    value = 0.0
    for _ in range(steps):
        direction = direction / direction.norm().clamp(min=1e-30)
        pushed = torch.func.jvp(function, (at,), (direction,))[1]
        value = float(pushed.detach().norm())
        pull = torch.func.vjp(function, at)[1]
        direction = pull(pushed)[0].detach()
    return value


def relative_changes(states: list[Tensor]) -> list[float]:
    """log10 |u^{k+1} - u^k| / |u^{k+1}| of consecutive states (the paper's convergence curve)."""
    return [relative_change(a, b) for a, b in pairwise(states)]


def relative_change(a: Tensor, b: Tensor) -> float:
    """log10 |b - a| / |b|, at least -16: they are then equal."""
    return max(-16.0, float((b - a).norm().div(b.norm().clamp(min=1e-30)).log10()))


@torch.no_grad()
def passes(network: Nano, counts: Tensor, exposure: Tensor | None, count: int) -> list[Tensor]:
    """The volumes u^1 .. u^count of algorithm 1 on one measurement."""
    start, run = _one_pass(network, counts, exposure)
    states = [run(start)]
    for _ in range(1, count):
        states.append(run(states[-1]))
    return states


def contraction(network: Nano, counts: Tensor, exposure: Tensor | None = None, steps: int = 12) -> Contraction:
    """Lipschitz estimates at the states that one measurement runs through; for the physical reading."""
    unfolding = network.unfolding
    if not isinstance(unfolding, PhysicalUnfolding):
        raise ValueError("the estimates are made for the physical reading; build nano with reading=physical")
    start, run = _one_pass(network, counts, exposure)
    seen: list[tuple[torch.nn.Module, tuple[Tensor, ...]]] = []

    def note(module: torch.nn.Module, inputs: tuple[Tensor, ...]) -> None:
        seen.append((module, inputs))

    watched = [step for scale in unfolding.iterations for step in cast(torch.nn.ModuleList, scale)]
    hooks = [module.register_forward_pre_hook(note) for module in (*watched, unfolding.lift_u, network.head)]
    with torch.no_grad():
        run(start)
    for hook in hooks:
        hook.remove()
    values: dict[torch.nn.Module, float] = {}
    changes: dict[torch.nn.Module, float] = {}
    for module, (first, *others) in seen:

        def one(x: Tensor, module: torch.nn.Module = module, others: list[Tensor] = others) -> Tensor:
            out: Tensor = module(x, *others)
            return out

        values[module] = lipschitz(one, first.contiguous(), steps)
        if module in watched:
            with torch.no_grad():
                changes[module] = relative_change(first, one(first))
    return Contraction(
        lifting=values[unfolding.lift_u],
        projection=values[network.head],
        iterations=tuple(values[module] for module in watched),
        whole_pass=lipschitz(run, run(start).detach(), steps),
        changes=tuple(changes[module] for module in watched),
    )


def _one_pass(network: Nano, counts: Tensor, exposure: Tensor | None) -> tuple[Tensor, Map]:
    """u^0 = 0 and the map u^{s-1} -> u^s of one measurement."""
    with torch.no_grad():
        volumes, eta, maps, lifted, _ = network.prepared(counts, exposure)
        features = network.features(volumes, maps, lifted)

    def run(u: Tensor) -> Tensor:
        return network.operator(network.with_last(features, u), volumes, eta, maps).volume

    return torch.zeros_like(volumes[:, 0]), run


def networks() -> dict[str, Path | str]:
    """Weights by what they are called in the figure: those that ship, and those of `make ablations` with S > 1."""
    found: dict[str, Path | str] = {"nano": "nano"}
    for row in in_order():
        path = folder_of(row, SAMPLES) / WEIGHTS
        if row.switches.keys() - WHOLE.keys() == {"outer_iterations"} and path.exists():
            found[f"trained with {row.name}"] = path
    return found


def measure(path: Path, count: int = 12) -> dict[str, Any]:
    """Every network on the first validation scan of the ablations; draws the figure to `path`."""
    batch = collate([sample(VALIDATION, 0)])
    curves, found = {}, {}
    for name, weights in networks().items():
        settings = Settings(weights=str(weights), outer_iterations=2)
        network = build(settings, VALIDATION.wall, VALIDATION.time)
        curves[name] = relative_changes(passes(network, batch["counts"], batch["exposure"], count))
        found[name] = contraction(network, batch["counts"], batch["exposure"])
    figure(curves, found, path)
    return {name: asdict(one) | {"product": one.product, "log10_changes": curves[name]} for name, one in found.items()}


def figure(curves: dict[str, list[float]], found: dict[str, Contraction], path: Path) -> None:
    """The curves of relative changes beside the Lipschitz estimates."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(9, 3.5), layout="constrained")
    left, right = drawing.subplots(1, 2)
    width = 0.8 / len(found)
    for k, (name, one) in enumerate(found.items()):
        left.plot(range(1, len(curves[name]) + 1), curves[name], "o-", label=name)
        names = ["B_l", *(f"A_{j}" for j in range(len(one.iterations))), "B_p", "G"]
        heights = [one.lifting, *one.iterations, one.projection, one.whole_pass]
        right.bar([j + k * width for j in range(len(names))], heights, width)
        right.set_xticks(range(len(names)), names)
    left.set(xlabel="pass s", ylabel="log10 |u(s+1) - u(s)| / |u(s+1)|", title="Algorithm 1")
    left.legend(fontsize=7)
    right.axhline(1.0, color="k", lw=0.8)
    right.set(ylabel="local Lipschitz estimate", title="Parts of the operator")
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, dpi=90)


if __name__ == "__main__":
    print(json.dumps(measure(Path(sys.argv[1]))))

"""Does algorithm 1 converge? Relative changes of its passes and iterations, and Lipschitz estimates of its parts.

`python -m studies.convergence FIGURE.png` measures the weights that come with the program, of both readings, and
networks that `make studies` has trained through one pass and more: the parts on one simulated scan, whole passes on
eight.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from nlos.recon.methods import faithful, nano
from nlos.recon.training.dataset import sample
from nlos.recon.training.run_folder import WEIGHTS
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import place_of
from studies.convergence_figure import figure
from studies.rows import PASSES, SAMPLES, SEEDS, TABLES, WATCHED, folder_of, kept_of

LEGEND = (
    "`faithful` is the operator as the paper prints it, trained on 4,000 samples (docs/paper.md), `nano` what ships. "
    "B_l is the lifting, A_k the k-th iteration, B_p the projection, G a whole pass. Below the dashed line at 1 a "
    "part brings two inputs closer together; theorem 2 asks it of their product. `nano` lies at -16, which is "
    "equality and outside the figure: its B_l is 0, a trivial fixed point. Those of 1,000 samples are rows of "
    "docs/ablations.md, trained through S passes. Their weights are in no file of the repository; `make studies` "
    "makes them again.\n\nWhere the table does not say how many scans, it is one: the first of the held-out scenes "
    "that rows are watched on, 32 x 32 points. Every constant is a local one, the largest singular value of the "
    "Jacobian at the state that the scan leads to, by 12 steps of power iteration, of whole passes by 20: a lower "
    "bound of the theorem's, which holds everywhere. The theorem has one C_B for all iterations, so it is the "
    "largest; below it stands the product of each iteration's own. Neither bounds a whole pass: what restricts, "
    "prolongs and aggregates scales is in no factor, neither here nor in the theorem.\n"
)
"""What the figure and the table do not say by themselves."""
MANY = WATCHED.model_copy(update={"scenes": 8})
"""Scans on which whole passes are measured; the parts are measured on the first."""
STEPS = 20
"""Of power iteration, of a whole pass on each of them."""

Map = Callable[[Tensor], Tensor]
Network = nano.Nano | faithful.Faithful


@dataclass(frozen=True)
class Contraction:
    """Local Lipschitz estimates, C_p C_B^K C_l, which theorem 2 of the paper asks to be below 1, and changes."""

    lifting: float  # B_l: u^{s-1} -> u^0 and everything else that depends on u^{s-1} alone
    projection: float  # B_p: u^K -> u
    iterations: tuple[float, ...]  # I - dt S of each iteration, finest scale first
    whole_pass: float  # u^{s-1} -> u^s
    changes: tuple[float, ...]  # log10 |u^{k+1} - u^k| / |u^{k+1}| of each iteration

    @property
    def product(self) -> float:
        """C_p C_B^K C_l of the theorem, whose C_B is one for all K iterations: the largest."""
        return self.lifting * self.projection * max(self.iterations) ** len(self.iterations)

    @property
    def own_product(self) -> float:
        """The same with every iteration at its own estimate."""
        return self.lifting * self.projection * float(torch.tensor(self.iterations).prod())


@dataclass(frozen=True)
class Settling:
    """Whole passes on many scans, a value a scan."""

    whole_passes: tuple[float, ...]  # local Lipschitz estimates of u^1 -> u^2, at u^1
    log10_changes: tuple[tuple[float, ...], ...]  # (scans, passes - 1), see `relative_changes`

    @property
    def ratios(self) -> tuple[float, ...]:
        """By what a pass multiplies the change of the one before, the geometric mean of the second half of passes."""
        half = len(self.log10_changes[0]) // 2
        steps = len(self.log10_changes[0]) - 1 - half
        return tuple(10 ** ((changes[-1] - changes[half]) / steps) for changes in self.log10_changes)


@dataclass(frozen=True)
class Pass:
    """One pass of algorithm 1 on one measurement, taken apart."""

    start: Tensor  # what the first pass begins with
    run: Map  # u^{s-1} -> u^s
    lift: Map  # u^{s-1} -> all that depends on it before the first iteration, in one vector
    project: Map  # the last state -> u
    before_project: nn.Module  # its first input is the last state
    steps: tuple[nn.Module, ...]  # the iterations: the first input is the state


def lipschitz(function: Map, at: Tensor, steps: int = 12, seed: int = 0) -> float:
    """The largest singular value of the Jacobian of `function` at `at`, by power iteration on J^T J. Complex numbers
    are taken as pairs of real ones."""
    if at.is_complex():
        return lipschitz(lambda x: as_real(function(torch.view_as_complex(x))), torch.view_as_real(at), steps, seed)
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(at.shape, generator=generator)
    pull = torch.func.vjp(function, at)[1]
    value = 0.0
    for _ in range(steps):
        direction = direction / direction.norm().clamp(min=1e-30)
        pushed = torch.func.jvp(function, (at,), (direction,))[1]
        value = float(pushed.detach().norm())
        direction = pull(pushed)[0].detach()
    return value


def relative_changes(states: list[Tensor]) -> list[float]:
    """log10 |u^{k+1} - u^k| / |u^{k+1}| of consecutive states (the paper's convergence curve)."""
    return [relative_change(a, b) for a, b in pairwise(states)]


def relative_change(a: Tensor, b: Tensor) -> float:
    """log10 |b - a| / |b|, at least -16: they are then equal."""
    return max(-16.0, float((b - a).norm().div(b.norm().clamp(min=1e-30)).log10()))


def as_real(x: Tensor) -> Tensor:
    """Pairs of real numbers for complex ones, anything else as it is."""
    return torch.view_as_real(x) if x.is_complex() else x


@torch.no_grad()
def passes(network: Network, counts: Tensor, exposure: Tensor | None, count: int) -> list[Tensor]:
    """The volumes u^1 .. u^count of algorithm 1 on one measurement."""
    one = one_pass(network, counts, exposure)
    states = [one.run(one.start)]
    for _ in range(1, count):
        states.append(one.run(states[-1]))
    return states


def contraction(network: Network, counts: Tensor, exposure: Tensor | None = None, steps: int = 12) -> Contraction:
    """Lipschitz estimates at the states that one measurement runs through."""
    one = one_pass(network, counts, exposure)
    seen: dict[nn.Module, tuple[Tensor, ...]] = {}

    def note(module: nn.Module, inputs: tuple[Tensor, ...]) -> None:
        seen[module] = inputs

    hooks = [module.register_forward_pre_hook(note) for module in (*one.steps, one.before_project)]
    with torch.no_grad():
        first = one.run(one.start)
    for hook in hooks:
        hook.remove()
    values, changes = [], []
    for module in one.steps:
        state, *others = seen[module]

        def step(x: Tensor, module: nn.Module = module, others: list[Tensor] = others) -> Tensor:
            out: Tensor = module(x, *others)
            return out

        values.append(lipschitz(step, state.contiguous(), steps))
        with torch.no_grad():
            changes.append(relative_change(state, step(state)))
    return Contraction(
        lifting=lipschitz(one.lift, first, steps),
        projection=lipschitz(one.project, seen[one.before_project][0].contiguous(), steps),
        iterations=tuple(values),
        whole_pass=lipschitz(one.run, first, steps),
        changes=tuple(changes),
    )


def one_pass(network: Network, counts: Tensor, exposure: Tensor | None) -> Pass:
    """Algorithm 1 of one measurement, of either reading."""
    with torch.no_grad():
        return _of_nano(network, counts, exposure) if isinstance(network, nano.Nano) else _of_printed(
            network, counts, exposure
        )  # fmt: skip


def _of_nano(network: nano.Nano, counts: Tensor, exposure: Tensor | None) -> Pass:
    volumes, eta, maps, lifted = network.prepared(counts, exposure)[:4]
    features = network.features(volumes, maps, lifted)
    unfolding = network.unfolding

    def run(u: Tensor) -> Tensor:
        return network.operator(network.with_last(features, u), volumes, eta, maps).volume

    def lift(u: Tensor) -> Tensor:
        seen = network.with_last(features, u)
        return torch.cat([unfolding.lift_u(seen).flatten(), unfolding.lift_g(seen).flatten()])

    steps = tuple(step for scale in unfolding.iterations for step in cast(nn.ModuleList, scale))
    return Pass(torch.zeros_like(volumes[:, 0]), run, lift, network.head, network.head, steps)


def _of_printed(network: faithful.Faithful, counts: Tensor, exposure: Tensor | None) -> Pass:
    prepared = network.prepared(counts, exposure)
    unfolding = network.unfolding

    def run(u: Tensor) -> Tensor:
        return network.one_pass(u, prepared.lifted, prepared.guide, prepared.log_noise)

    def lift(u: Tensor) -> Tensor:
        return as_real(unfolding.lift(unfolding.spectrum(u))).flatten()

    steps = [step for scale in unfolding.iterations for step in cast(nn.ModuleList, scale)]
    if unfolding.encoded is not None:
        steps.append(unfolding.encoded)
    return Pass(prepared.start, run, lift, unfolding.project, unfolding.project, tuple(steps))


def trained() -> dict[str, tuple[Path, dict[str, Any]]]:
    """Weights of `make studies` by passes, of the first seed that is there, and what is switched in them, by what they
    are called in the figure."""
    found = {}
    for row in reversed(TABLES[PASSES]):
        there = [seed for seed in SEEDS if (folder_of(row, SAMPLES, seed) / WEIGHTS).exists()]
        done = [seed for seed in there if kept_of(row, SAMPLES, seed).exists()]
        if done:
            path = folder_of(row, SAMPLES, done[0]) / WEIGHTS
            found[f"faithful, {SAMPLES:,} samples, {row.name}"] = path, row.switches
    return found


def networks() -> dict[str, Network]:
    """By what they are called in the figure: those that ship, and those of `make studies` by passes."""
    wall, time = WATCHED.wall, WATCHED.time
    found: dict[str, Network] = {"nano": nano.build(nano.Settings(outer_iterations=2), wall, time)}
    if place_of("faithful").exists():
        found["faithful"] = faithful.build(faithful.Settings(outer_iterations=2), wall, time)
    for name, (path, switches) in trained().items():
        found[name] = faithful.build(faithful.Settings(weights=str(path), **switches), wall, time)
    return found


def measure(path: Path, count: int = 12) -> dict[str, Any]:
    """Every network on the first scan of the ablations' held-out scenes, whole passes on more of them; draws the figure
    to `path`."""
    scans = [collate([sample(MANY, index)]) for index in range(len(MANY))]
    curves, found, settled = {}, {}, {}
    for name, network in networks().items():
        found[name] = contraction(network, scans[0]["counts"], scans[0]["exposure"])
        settled[name] = settling(network, scans, count)
        curves[name] = list(settled[name].log10_changes[0])
    figure(curves, found, path)
    return {
        name: asdict(one)
        | {"product": one.product, "own_product": one.own_product, "ratios": settled[name].ratios}
        | asdict(settled[name])
        for name, one in found.items()
    }


def settling(network: Network, scans: Sequence[Mapping[str, Tensor]], count: int, steps: int = STEPS) -> Settling:
    """`count` passes on each scan, and the Lipschitz estimate of the second."""
    estimates, changes = [], []
    for scan in scans:
        one = one_pass(network, scan["counts"], scan["exposure"])
        with torch.no_grad():
            first = one.run(one.start)
        estimates.append(lipschitz(one.run, first, steps))
        changes.append(tuple(relative_changes(passes(network, scan["counts"], scan["exposure"], count))))
    return Settling(tuple(estimates), tuple(changes))


if __name__ == "__main__":
    print(json.dumps(measure(Path(sys.argv[1]))))

"""Runs a method of the catalogue on a transient, by torch."""

import os
from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import cast

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon import parts
from nlos.recon.contract import wrong_numbers, wrong_shapes
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.layers.placed import placed
from nlos.recon.method import Method, MethodResult, sure, takes_response
from nlos.recon.methods import find, in_words
from nlos.recon.own_methods import defined_at, name_of, with_its_line
from nlos.recon.weights.files import WeightsError, sha256_of

Floats = npt.NDArray[np.float32]
Depths = npt.NDArray[np.float64]

if hasattr(os, "register_at_fork"):  # not on Windows. A child has none of its parent's threads, and OpenMP awaits them
    os.register_at_fork(after_in_child=partial(torch.set_num_threads, 1))


def see_by(
    method: str, settings: Settings, transient: Transient, device: str = "cpu"
) -> tuple[MethodResult[Floats], Depths, bool]:
    """What a method makes of one transient, the depths of its planes, (D,), none where it says none, and whether it
    takes the instrument's response into account.

    Raises `ReconstructionFailed` where what it makes is not of the shapes in `recon/method.py`.
    """
    found = find(method)
    with with_its_line(name_of(method), found):
        module = built(cast(Hashable, found), _by_words(settings), transient.wall, transient.time)
        return *see(transient, module, device, defined_at(found, "forward")), takes_response(module)


def get_ready_for(method: str, settings: Settings, transient: Transient) -> None:
    """Builds a method for such a transient; `see_by` then finds it built. Raises as that does."""
    found = find(method)
    with with_its_line(name_of(method), found):
        built(cast(Hashable, found), _by_words(settings), transient.wall, transient.time)


def see(
    transient: Transient, module: nn.Module, device: str = "cpu", own_at: str = ""
) -> tuple[MethodResult[Floats], Depths]:
    """What a method built for this wall and time axis makes of one transient, and the depths of its planes, (D,).

    `own_at`: `file:line: ` of a method of one's own, whose numbers are then looked at too.
    """
    module = placed(module, device)
    # A method of one's own may go down gradients, by `torch.enable_grad()`: of inference tensors there are none.
    with torch.no_grad() if own_at else torch.inference_mode():
        counts = torch.from_numpy(np.ascontiguousarray(transient.counts, np.float32))[None, None].to(device)
        exposure_s = torch.from_numpy(np.ascontiguousarray(transient.exposure_s))[None].to(device)
        told: tuple[torch.Tensor, ...] = ()
        if transient.response is not None and takes_response(module):
            taps = transient.response.taps(transient.time.bin_width_s)
            told = (torch.from_numpy(taps)[None].float().to(device),) if len(taps) > 1 else ()
        with parts.told(module):
            if own_at:  # it may write into what it is given, which is the scan that later pictures are made of
                counts, exposure_s = counts.clone(), exposure_s.clone()
            made: MethodResult[torch.Tensor] = module(counts, exposure_s, *told)
    depths_m = _planes(getattr(module, "depths_m", ()), own_at)
    wrong = wrong_shapes(made, depths_m.size, transient.wall)
    if own_at:
        wrong = wrong or wrong_numbers(made, depths_m, transient.time)
    if wrong:
        raise ReconstructionFailed(f"{own_at}{wrong} (nlos.recon.method is the contract)")
    volume = None if made.volume is None else _array(made.volume)
    of_each = getattr(made, "intervals", None)
    known = None if of_each is None else {name: _array(x) for name, x in of_each.items()}
    return sure(MethodResult(_array(made.albedo), _array(made.depth_m), volume), known), depths_m


def _array(tensor: torch.Tensor) -> Floats:
    """Of the one measurement of a batch; NumPy has no bfloat16."""
    first = tensor[0].detach().cpu()
    return (first.float() if first.dtype is torch.bfloat16 else first).numpy()


def _planes(said: object, own_at: str) -> Depths:
    """The depths of a method's planes, (D,). Raises `ReconstructionFailed`."""
    try:
        return np.asarray(said.detach().cpu() if isinstance(said, torch.Tensor) else said, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ReconstructionFailed(
            f"{own_at}depths_m is {said!r:.60}, must be the planes' depths in metres, (D,)"
        ) from error


@dataclass(frozen=True)
class _ByWords:
    """Settings that are looked up by what they say (lists, which a method of one's own may have, have no hash) and by
    the weights that they name as those are now: a training that goes on has written others into the same file."""

    words: str
    weights_sha256: tuple[str, ...]
    settings: Settings = field(compare=False)


def _by_words(settings: Settings) -> _ByWords:
    named = (getattr(settings, name, None) for name in ("weights", "noise_weights"))
    return _ByWords(in_words(settings), tuple(_weights_now(each) for each in named), settings)


def _weights_now(named: object) -> str:
    """Their SHA-256; empty where there are none, which is for whoever reads them to say."""
    if not isinstance(named, str):
        return ""
    try:
        return sha256_of(named)
    except WeightsError:
        return ""


@lru_cache(maxsize=6)  # three of each of two axes: those before a film is aligned are still in use just after it is
def built(method: Hashable, said: _ByWords, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """A method, kept for the next transient of the same shape. Raises `ReconstructionFailed`."""
    module: object = cast(Method, method).build(said.settings, wall, time)
    if not isinstance(module, nn.Module):
        what = f"build returned {type(module).__name__}, not an nn.Module"
        raise ReconstructionFailed(f"{defined_at(method, 'build')}{what}")
    return module.eval()

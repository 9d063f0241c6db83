"""The contract of every method, by physics or learned: what it is given, what it makes.

A method is a file with a first docstring line for the catalogue, a class `Settings`, and `build(settings, wall, time)`.
What `build` returns is an `nn.Module` that is called with

    counts      (B, 1, T, H, W), float32: time 0 is at the wall, direct light is removed
    exposure_s  (B, H, W), 0 = not measured, or None where every point was exposed alike

and, where the module says `takes_response = True` and one is known,

    response    (B, K): what an instant of light becomes, shares a bin, K odd, the middle one on time

and returns a `MethodResult`; where that has a volume, the module's `depths_m`, (D,), says where its planes lie. A
method by physics makes the volume and hands it to `physics.seen_in`. One that learns has a setting `weights` with the
default None, and is trained as it is: `nlos train` knows it by the same word.

The file is in `recon/methods`, or anywhere: its path, which ends in `.py`, is a method's name wherever one is asked
for. A package offers its own by an entry point of the group `nlos.methods`: a word -> the module that is such a file.
`docs/howto/methods.md` shows one of thirty lines.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Generic, NamedTuple, Protocol, TypeVar

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings

if TYPE_CHECKING:
    import torch

Array = TypeVar("Array")


class MethodResult(NamedTuple, Generic[Array]):
    """What a method makes of counts: tensors with a batch first, or NumPy arrays of one measurement without it."""

    albedo: Array
    """(B, H, W) front view, not negative; its unit is the method's own."""
    depth_m: Array
    """(B, H, W) depth from the wall, NaN where nothing is seen."""
    volume: Array | None = None
    """(B, D, H, W) albedo at the method's `depths_m`; None where it makes none."""


class SureResult(MethodResult[Array]):
    """A result whose method knows how sure it is; still three fields to whoever unpacks it."""

    intervals: Mapping[str, Array] | None = None
    """90 % intervals `albedo_low`, `albedo_high`, `depth_low_m`, `depth_high_m`, and `seen`, the probability that there
    is a surface, (B, H, W) each; None where it does not know."""


def sure(made: MethodResult[Array], intervals: Mapping[str, Array] | None) -> MethodResult[Array]:
    """The same result with its intervals."""
    result = SureResult(*made)
    result.intervals = intervals
    return result


class Method(Protocol):
    """What a method's file offers."""

    Settings: type[AnySettings]

    def build(self, settings: AnySettings, wall: WallGrid, time: TimeAxis) -> "torch.nn.Module":
        """An `nn.Module` for one geometry, as above. Raises `InvalidSettings` where the settings do not fit it."""
        ...


def takes_response(built: object) -> bool:
    """Whether a built method wants to be told the instrument's response."""
    return bool(getattr(built, "takes_response", False))

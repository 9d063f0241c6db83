"""Phasor field: a virtual camera behind the wall, focused on every voxel; good with noise and clutter."""

from functools import partial
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
import torch
from pydantic import Field, model_validator
from torch import nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.errors import InvalidSettings
from nlos.recon.front_view import depth_map
from nlos.recon.memory import cube_bytes
from nlos.recon.method import MethodResult
from nlos.recon.physics import prepare, seen_in
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.transport.conventions import depths_m, range_m
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.light_cone import LightConeConvolution
from nlos.recon.transport.phasor_field import KEPT_FILTER_BYTES, ConfocalRsd, frequencies_per_m
from nlos.recon.transport.resampling import LightConeResampling
from nlos.recon.transport.virtual_wave import VirtualWave
from nlos.recon.volume_method import VolumeMethod

NEAREST = 128
"""The last plane is at most so many times as deep as the first: a closer one sees the one point before it alone."""
KEPT = 0.45  # of a wave's amplitude that a response must leave; 0.4 and 0.5 serve as well


class Settings(PhysicsSettings):
    """Settings of the phasor field. It has no inverse filter: `snr` changes nothing."""

    has_inverse_filter: ClassVar[bool] = False

    variant: Literal["rsd", "light_cone"] = "rsd"
    """The exact confocal propagator, or the approximation in light-cone space (the authors' conventions use that)."""
    wavelength_m: Annotated[float, Field(gt=0)] | None = None
    """Of the virtual wave, along the light's path; four wall pixels unless given, more where the instrument's response
    would not leave enough of these."""
    cycles: Annotated[float, Field(ge=1, le=50)] | None = None
    """In the pulse; 4 unless given, 5 as published. Fewer see finer depth, more suppress noise."""
    planes: Annotated[int, Field(ge=2)] = 128
    """Depth planes of the exact propagator."""
    near_m: Annotated[float, Field(gt=0)] | None = None
    """Depth of the first plane; unless given the last one's, divided by `planes`, or by 128 where there are more."""
    far_m: Annotated[float, Field(gt=0)] | None = None
    """Depth of the last plane; the end of the time axis unless given."""

    @model_validator(mode="after")
    def _planes_are_the_exact_propagators(self) -> Self:
        given = [name for name in ("near_m", "far_m") if getattr(self, name) is not None]
        if given and self.on_the_light_cone:
            raise ValueError(
                f"{' and '.join(given)}: planes of the exact propagator (variant rsd, conventions physical), not of "
                "the light cone. Choose its depths with --depth-m NEAR:FAR"
            )
        return self

    @property
    def on_the_light_cone(self) -> bool:
        """Whether it is the approximation, which the authors' conventions use."""
        return self.variant == "light_cone" or self.conventions == "authors"

    def bytes_needed(self, wall: WallGrid, time: TimeAxis, told: bool = False) -> int:
        """Of the exact propagator: every frequency's padded wall three times over, and a plane's kernels a thread."""
        if self.on_the_light_cone:
            return 10 * cube_bytes(wall, time)
        count = len(frequencies_per_m(time, _wavelength_m(self, wall), _cycles(self)))
        kernels = 8 * wall.rows * wall.cols * count  # of one plane: a quarter of the padded wall
        kept = kernels * self.planes if kernels * self.planes <= KEPT_FILTER_BYTES else 0
        return 3 * cube_bytes(wall, time) + kernels * (12 + 4 * torch.get_num_threads()) + kept

    def smaller(self, wall: WallGrid, time: TimeAxis, free: int, told: bool = False) -> dict[str, int]:
        """Longer waves need fewer frequencies."""
        if self.on_the_light_cone:
            return super().smaller(wall, time, free)
        longer = [self.model_copy(update={"wavelength_m": _wavelength_m(self, wall) * k}) for k in (2, 4, 8)]
        return {f"wavelength_m={other.wavelength_m:g}": other.bytes_needed(wall, time) for other in longer}


class Camera(VolumeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) magnitude of the exact propagator's field."""

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        bins_m = depths_m(time, "physical")
        first_m = max(bins_m[0], bins_m[-1] / min(settings.planes, NEAREST))
        near_m = first_m if settings.near_m is None else settings.near_m
        far_m = bins_m[-1] if settings.far_m is None else settings.far_m
        if not near_m < far_m:
            raise InvalidSettings(f"near_m is {near_m:g} m and far_m {far_m:g} m; near must lie before far")
        if far_m > (end_m := range_m(time, "physical")):
            raise InvalidSettings(
                f"far_m is {far_m:g} m, but light is looked at to {end_m:.4g} m: farther planes would show it once "
                f"more. Take no more, or add --depth-m :{far_m:g} where the recording reaches as far."
            )
        self.depths_m = np.linspace(near_m, far_m, min(settings.planes, time.bins))
        self.falloff = Falloff(time, settings.falloff)
        self.wall, self.wavelength_m = wall, _wavelength_m(settings, wall)
        self.propagate = self._propagator(self.wavelength_m)
        self.depth_by = partial(depth_map, fading_per_m=_fading_per_m(wall, self.depths_m))
        self.slower: tuple[float, ConfocalRsd] | None = None

    def volume(
        self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """The magnitude of the field in focus; where a `response` (B, K) is told, of a wave that it leaves standing."""
        signal, _ = prepare(counts, exposure_s, self.settings, self.time, self.falloff)
        if response is None:
            field: torch.Tensor = self.propagate(signal)
            return field.abs()
        told = zip(signal, response.expand(len(signal), -1), strict=True)
        return torch.cat([self._where_told(taps)(one[None]).abs() for one, taps in told])

    def _where_told(self, taps: torch.Tensor) -> ConfocalRsd:
        """The propagator of a wave that a response (K,) leaves standing; the last one is kept."""
        wavelength_m = _wavelength_left_m(self.settings, self.wall, self.time, taps)
        if wavelength_m == self.wavelength_m:
            return self.propagate
        if self.slower is None or self.slower[0] != wavelength_m:
            self.slower = wavelength_m, self._propagator(wavelength_m)
        return self.slower[1]

    def _propagator(self, wavelength_m: float) -> ConfocalRsd:
        return ConfocalRsd(self.wall, self.time, self.depths_m, wavelength_m, _cycles(self.settings))


class LightConeCamera(nn.Module):
    """(B, C, T, H, W) counts -> (B, C, D, H, W) magnitude, back-projected on the light cone. Falloff is left alone."""

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__()
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.wave = VirtualWave(time, _wavelength_m(settings, wall), _cycles(settings), settings.conventions)
        self.resample = LightConeResampling(time, settings.conventions)
        self.cone = LightConeConvolution(wall, time, settings.conventions)

    def forward(self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None) -> MethodResult[torch.Tensor]:
        """The volume, its front view and its depth map."""
        return seen_in(self.volume(counts, exposure_s), self.depths_m)

    def volume(self, counts: torch.Tensor, exposure_s: torch.Tensor | None = None) -> torch.Tensor:
        """The magnitude on the light cone, resampled to depth."""
        signal, _ = prepare(counts, exposure_s, self.settings, self.time, None)
        phasors = self.wave(signal)
        real, imaginary = (self.cone.adjoint(self.resample(part)) for part in (phasors.real, phasors.imag))
        return self.resample.adjoint(torch.hypot(real, imaginary))


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """The camera for one geometry. Raises `InvalidSettings` where the wave does not fit it."""
    assert isinstance(settings, Settings)
    wavelength_m, path_m = _wavelength_m(settings, wall), 2 * range_m(time, "physical")
    if _cycles(settings) * wavelength_m > path_m:
        raise InvalidSettings(
            f"a pulse of {_cycles(settings):g} cycles of {wavelength_m:g} m is longer than the time axis, {path_m:g} m "
            "of light path. Choose a smaller wavelength_m or fewer cycles."
        )
    lightcone = settings.on_the_light_cone
    return LightConeCamera(settings, wall, time) if lightcone else Camera(settings, wall, time)


def _fading_per_m(wall: WallGrid, depths_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """What the propagator, 1 / distance^2 from each wall point, lets a point in front of the wall's middle fade by."""
    across_m2 = wall.x_m() ** 2 + wall.y_m()[:, None] ** 2
    gathered = (1 / (across_m2 + depth_m**2) for depth_m in depths_m)
    return np.array([2 * z * (g**2).sum() / g.sum() for z, g in zip(depths_m, gathered, strict=True)])


def _wavelength_m(settings: Settings, wall: WallGrid) -> float:
    """Four pixels: twice what the wall samples at two points a wave, out and back."""
    if settings.wavelength_m is not None:
        return settings.wavelength_m
    if settings.conventions == "authors":
        return 4 * wall.width_m / (wall.cols - 1)
    return 4 * max(wall.width_m / wall.cols, wall.height_m / wall.rows)


def _wavelength_left_m(settings: Settings, wall: WallGrid, time: TimeAxis, taps: torch.Tensor) -> float:
    """The wave's length, longer where a response (K,) would leave less than `KEPT` of it: there is then nothing but
    noise in it. Never so long that the pulse does not fit the time axis; as given, where it is given."""
    wavelength_m = _wavelength_m(settings, wall)
    if settings.wavelength_m is not None:
        return wavelength_m
    shares = taps.cpu().double().numpy()
    bin_m = SPEED_OF_LIGHT_M_PER_S * time.bin_width_s
    place_m = (np.arange(len(shares)) - len(shares) // 2) * bin_m
    longest_m = 2 * range_m(time, "physical") / _cycles(settings)  # `build` refuses a longer one
    lengths_m = np.geomspace(wavelength_m, longest_m, 200)
    left = np.abs(np.exp(-2j * np.pi * place_m / lengths_m[:, None]) @ shares)
    return float(lengths_m[int(np.argmax(left >= KEPT))] if (left >= KEPT).any() else lengths_m[-1])


def _cycles(settings: Settings) -> float:
    if settings.cycles is not None:
        return settings.cycles
    return 5.0 if settings.conventions == "authors" else 4.0

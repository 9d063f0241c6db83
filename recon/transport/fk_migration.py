"""f-k migration: the scene as the source of a wave at time 0, found by running the measured wave backwards."""

from collections.abc import Iterable

import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.fourier import add_signal_, array_of, tensor_of
from nlos.recon.transport.linear import linear
from nlos.recon.transport.stolt import StoltMigration, scatter


class FkMigration(nn.Module):
    """Real field at the wall (B, C, T, H, W) -> complex field at time 0 (B, C, D, H, W), one plane a bin.

    See `StoltMigration`. The adjoint maps back to a real field.
    """

    def __init__(self, wall: WallGrid, time: TimeAxis, conventions: Conventions = "physical") -> None:
        super().__init__()
        self.wave, self.wall, self.time = StoltMigration(wall, time, conventions), wall, time

    def forward(self, field: torch.Tensor) -> torch.Tensor:
        """The migrated wave."""
        return linear(field, self._migrate, self._unmigrate)

    def adjoint(self, image: torch.Tensor) -> torch.Tensor:
        """The transpose of `forward` over the real numbers: (B, C, D, H, W) complex -> (B, C, T, H, W) real."""
        return linear(image, self._unmigrate, self._migrate)

    def _migrate(self, field: torch.Tensor) -> torch.Tensor:
        images = [tensor_of(self.wave.migrate(array_of(sample))) for sample in self._samples(field)]
        return (images[0][None] if len(images) == 1 else torch.stack(images)).reshape(field.shape)

    def _unmigrate(self, image: torch.Tensor) -> torch.Tensor:
        wave, fields = self.wave, []
        for sample in self._samples(image):
            spectrum = torch.fft.fft(sample, n=wave.padded[0], dim=0)[: wave.padded[0] // 2 + 1]
            wide = spectrum.new_zeros((len(spectrum), wave.padded[1], self.wall.cols))
            wide[:, : self.wall.rows] = spectrum
            spectrum = tensor_of(wave.stolt(array_of(wide), scatter))[:, : self.wall.rows]
            spectrum *= wave.about_middle(spectrum).conj()
            spectrum[1:-1] /= 2  # the transpose of a real FFT counts each frequency once, its inverse twice
            sample_field = spectrum.real.new_zeros((1, self.time.bins, *spectrum.shape[1:]))
            add_signal_(array_of(sample_field), array_of(spectrum[None]), wave.padded[0])
            fields.append(sample_field[0] * wave.gain(sample_field))
        return torch.stack(fields).reshape(image.shape)

    def _samples(self, x: torch.Tensor) -> Iterable[torch.Tensor]:
        expected = (self.time.bins, self.wall.rows, self.wall.cols)
        if tuple(x.shape[2:]) != expected:
            raise ValueError(
                f"migration was built for {expected} (T, H, W), the data are {tuple(x.shape[2:])}. "
                "Build it for the wall and time axis of the data."
            )
        return x.detach().reshape(-1, *expected)

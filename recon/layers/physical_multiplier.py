"""Spectral multipliers that are functions of physical frequency and of the noise, the same on every grid."""

import torch
from torch import Tensor, nn


def octant_frequencies(size: tuple[int, int, int], pitch: tuple[float, float, float]) -> list[Tensor]:
    """|f_z|, |f_y|, |f_x| of the octant of a (D, H, W) FFT grid, in cycles per unit of `pitch`, each (d, h, w)."""
    axes = [torch.arange(n // 2 + 1) / (n * step) for n, step in zip(size, pitch, strict=True)]
    return list(torch.meshgrid(*axes, indexing="ij"))


def mirror(octant: Tensor, n: int, dim: int, sign: float = 1.0) -> Tensor:
    """From frequencies 0..n//2 to the FFT order of all n, the negative ones times `sign`."""
    tail = octant.narrow(dim, 1, (n - 1) // 2).flip(dim)
    return torch.cat((octant, sign * tail), dim=dim)


class PhysicalMultiplier(nn.Module):
    """M(f; eta) = M_0(f) + sum_m a_m(eta) M_m(f), M_m an MLP of (f_z, f_r, |f|, f_z - f_r, log f_r).

    Stands for the operators T and S_eta of the unfolded gradient flow (NANO, eq. 11) as a diagonal in the spectrum.
    Frequencies in cycles per wall width, divided by `highest`. The imaginary part is odd in f_z, so the kernel behind
    M is real, isotropic along the wall, and commutes with flips.
    """

    def __init__(self, channels: int, start: float, maps: int = 2, hidden: int = 32, highest: float = 32.0):
        super().__init__()
        self.channels, self.maps, self.highest = channels, maps, highest
        self.mlp = nn.Sequential(nn.Linear(5, hidden), nn.GELU(), nn.Linear(hidden, hidden), nn.GELU())
        self.head = nn.Linear(hidden, 2 * (1 + maps) * channels)
        with torch.no_grad():
            self.head.weight.mul_(0.3)
            self.head.bias.zero_()
            self.head.bias[:channels] = start

    def forward(self, gains: Tensor, size: tuple[int, int, int], pitch: tuple[float, float, float]) -> Tensor:
        """gains a(eta) (B, maps) -> complex multiplier (B, channels, D, H, W // 2 + 1), float32."""
        device = self.head.weight.device
        fz, fy, fx = (f.to(device) / self.highest for f in octant_frequencies(size, pitch))
        fr = (fy.square() + fx.square()).sqrt()
        inputs = torch.stack((fz, fr, (fz.square() + fr.square()).sqrt(), fz - fr, (fr + 0.03).log()), dim=-1)
        maps = self.head(self.mlp(inputs.float())).movedim(-1, 0)  # (2 (1 + maps) C, d, h, w)
        maps = maps.view(1 + self.maps, 2 * self.channels, *fz.shape)
        weights = torch.cat((torch.ones_like(gains[:, :1]), gains), dim=1).float()  # (B, 1 + maps)
        octant = torch.einsum("bm,mcdhw->bcdhw", weights, maps)
        real, imag = octant.chunk(2, dim=1)
        odd = fz.clone()
        if size[0] % 2 == 0:
            odd[-1] = 0  # at the Nyquist frequency f_z and -f_z are one bin, which a real kernel keeps real
        imag = mirror(mirror(imag * odd, size[0], 2, sign=-1.0), size[1], 3)
        real = mirror(mirror(real, size[0], 2), size[1], 3)
        return torch.complex(real, imag)

"""Spectral multipliers that are functions of physical frequency and of the noise, the same on every grid."""

from functools import lru_cache

import torch
from torch import Tensor, nn

Size = tuple[int, int, int]
Pitch = tuple[float, float, float]


@lru_cache(maxsize=64)
def described(size: Size, pitch: Pitch, highest: float, device: torch.device) -> tuple[Tensor, Tensor]:
    """What multipliers know of each frequency in the octant of a (D, H, W) FFT grid, (d, h, w, 5), and f_z, which makes
    them odd, (d, h, w); in cycles per unit of `pitch`, over `highest`."""
    with torch.inference_mode(False):  # it is kept, and whoever asks next may need gradients
        axes = [torch.arange(n // 2 + 1) / (n * step * highest) for n, step in zip(size, pitch, strict=True)]
        fz, fy, fx = torch.meshgrid(*axes, indexing="ij")
        fr = (fy.square() + fx.square()).sqrt()
        known = torch.stack((fz, fr, (fz.square() + fr.square()).sqrt(), fz - fr, (fr + 0.03).log()), dim=-1)
        odd = fz.clone()
        if size[0] % 2 == 0:
            odd[-1] = 0  # at the Nyquist frequency f_z and -f_z are one bin, which a real kernel keeps real
        return known.float().to(device), odd.to(device)


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

    def forward(self, gains: Tensor, size: Size, pitch: Pitch) -> Tensor:
        """gains a(eta) (B, maps) -> complex multiplier (B, channels, D, H, W // 2 + 1), float32."""
        known, odd = described(size, pitch, self.highest, self.head.weight.device)
        maps = self.head(self.mlp(known)).movedim(-1, 0)  # (2 (1 + maps) C, d, h, w)
        maps = maps.view(1 + self.maps, 2 * self.channels, *odd.shape)
        weights = torch.cat((torch.ones_like(gains[:, :1]), gains), dim=1).float()  # (B, 1 + maps)
        octant = torch.einsum("bm,mcdhw->bcdhw", weights, maps)
        real, imag = octant.chunk(2, dim=1)
        imag = mirror(mirror(imag * odd, size[0], 2, sign=-1.0), size[1], 3)
        real = mirror(mirror(real, size[0], 2), size[1], 3)
        return torch.complex(real, imag)

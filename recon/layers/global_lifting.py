"""Global transient lifting: a 3D U-Net that sees the whole measurement."""

from torch import Tensor

from nlos.recon.layers.unet import UNet


class GlobalLifting(UNet):
    """F_g = U-Net_3D(tau): (B, C, T, H, W) -> (B, 4C, T, ceil(H/2), ceil(W/2)) (NANO, section IV-B1, "G-TL")."""

    def __init__(self, channels: int = 1, widths: tuple[int, ...] = (4, 8, 16)):
        super().__init__(3, channels, 4 * channels, widths, stride=(1, 2, 2))

    def forward(self, tau: Tensor) -> Tensor:
        return super().forward(tau)

"""One row of a table: what is trained, and what makes the rows that tables share."""

from dataclasses import dataclass, field
from typing import Any

from nlos.recon.training.losses import LossSettings

SURROGATE = ("cycles",)
"""Motorcycles and bicycles: what comes nearest to the paper's 277 motorcycles, and no more than that."""


def printed_loss(total_variation: float) -> LossSettings:
    """MSE + lambda TV."""
    return LossSettings(picture=10.0, depth=0.0, total_variation=total_variation)


PRINTED_LOSS = printed_loss(0.3)
OWN_LOSS = LossSettings(picture=5.0, log_picture=0.06, depth=2.0)
RATE = 1e-3


@dataclass(frozen=True)
class Row:
    """One row of one table: its name there, what is switched, and the paper's figures for it where it has them."""

    name: str
    method: str = "faithful"
    switches: dict[str, Any] = field(default_factory=dict)
    loss: LossSettings = PRINTED_LOSS
    paper: dict[str, float] = field(default_factory=dict)
    """At 15 to 30 dB, or where the paper says no range."""
    paper_dim: dict[str, float] = field(default_factory=dict)
    """At 15 to 20 dB."""
    times: float = 1.0
    """So many times the samples of other rows."""
    rate: float = RATE
    batch: int = 1
    """Samples a step."""
    noise_least: float = 0.0
    """Of the printed network: the smallest a of the U(0, a) added to what it learns from; the largest is 10."""
    kinds: tuple[str, ...] = ()
    """Trained and judged on scenes of these kinds alone, judged on other ones of them; all, judged on kinds that none
    was trained on, unless given."""
    mirrored: bool = False
    """Judged as the mean over the eight mirror images of the wall, by a training with the settings of the same row."""

    @property
    def trained(self) -> bool:
        """Whether there is anything to train."""
        return self.method != "lct"


def printed(psnr: float, ssim: float, rmse_m: float | None = None, mad_m: float | None = None) -> dict[str, float]:
    """The paper's figures for a row."""
    figures = {"psnr": psnr, "ssim": ssim, "depth_rmse_m": rmse_m, "depth_mad_m": mad_m}
    return {name: value for name, value in figures.items() if value is not None}


NO_NLE = {"nle": False}
"""The operator is told a middling level; falloff and snr of the inverse still follow the estimate (decision 163)."""
WHOLE: dict[str, Any] = {"symmetries": False, "lifting": "both", "sfe": True}
"""NANO before what brings nothing left it (decision 321), and the scan seen once, unmirrored."""
SHIPS = WHOLE | {"lifting": "none", "sfe": False}
"""As it ships, the scan seen once."""
NEAR = {"farthest": 0.9}
RIVALS_RATE = 0.0015
"""NANO's of 4,000 samples. For NLOST and the U-Net three rates were level after 150 and 500 samples (`configs/train/
nlost_4000.yaml`, `unet_4000.yaml`). NANO's and the printed network's rows run at `RATE`."""
STEP_MS = {"nano": 268, "lfe": 102, "nlost": 184, "unet": 141}
"""Of one core's time a step, data aside, as it ships; the four by turns in one process (bfloat16)."""
WITHOUT = "studies/nano_without.py"
GIVEN = "studies/rivals_given.py"
OURS = ("nano", "faithful", WITHOUT)
"""They are told the noise level, by an estimation that was trained before (1,900 steps) and is frozen."""


def rivals(how: str, kinds: tuple[str, ...] = ()) -> tuple[Row, ...]:
    """NANO as it ships, last, and three other networks on the same scenes with the same losses."""

    def times(method: str) -> float:
        return round(STEP_MS["nano"] / STEP_MS[method], 2) if how == "seconds" else 1.0

    wide = how == "parameters"
    lfe: dict[str, Any] = NEAR | ({"features": 8, "renderer_width": 52} if wide else {})
    unet: dict[str, Any] = NEAR | ({"widths": [18, 36, 54], "finish_widths": [36, 72, 144]} if wide else {})
    return (
        Row("LFE", "lfe", lfe, OWN_LOSS, times=times("lfe"), rate=RIVALS_RATE, kinds=kinds),
        Row("NLOST", "nlost", NEAR, OWN_LOSS, times=times("nlost"), rate=RIVALS_RATE, kinds=kinds),
        Row("U-Net", "unet", unet, OWN_LOSS, times=times("unet"), rate=RIVALS_RATE, kinds=kinds),
        Row("NANO", "nano", SHIPS, OWN_LOSS, kinds=kinds),
    )


def given(rival: str, mirrored: bool) -> Row:
    """A rival shown gaps filled as well as empty."""
    name = {"lfe": "LFE", "nlost": "NLOST", "unet": "U-Net"}[rival] + (", mirrored" if mirrored else "")
    return Row(name, GIVEN, NEAR | {"rival": rival}, OWN_LOSS, rate=RIVALS_RATE, mirrored=mirrored)


def fixed(level: float) -> dict[str, Any]:
    """Told nothing of the noise: H at that level (log10), whatever the scan's, and no NLE."""
    return {"transport": "fixed", "middling": level} | NO_NLE


def longer(name: str, switches: dict[str, Any], method: str = "nano") -> Row:
    """NANO on four times the samples, two a step."""
    return Row(name, method, SHIPS | switches, OWN_LOSS, times=4, batch=2, rate=RIVALS_RATE)

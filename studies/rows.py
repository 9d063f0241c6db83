"""The rows of the paper's tables, and of what ships without one part: each a training of its own."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.losses import LossSettings
from nlos.recon.training.train_settings import TrainSettings

FOLDER = Path("runs/studies")
KEPT = Path("studies/judged")
"""What was measured, in the repository: three nights of trainings may be spread over machines that forget."""
FORM = "b"  # another letter once the networks or their training change: what was trained before is then trained again
SAMPLES = 1000
SEEDS = (1, 2, 3)
SMALL: dict[str, Any] = {"rows": 32, "cols": 32, "bins": 128, "bin_width_ps": 128.0}
WATCHED = DatasetSettings(seed=2, scenes=4, degradations=1, held_out=True, **SMALL)
"""While it trains; rows are judged on `JUDGED`."""


def photons(least: float, most: float) -> DatasetSettings:
    """Held-out scenes scanned at every point, so many counts in a point's brightest bin on average."""
    detector = DetectorSettings(
        peak_counts_least=least, peak_counts_most=most, noiseless=0.0, uniform=0.0, sparse=0.0, uneven_dwell=0.0
    )
    return DatasetSettings(seed=4, scenes=48, degradations=1, held_out=True, detector=detector, **SMALL)


PRINTED_AT = {"15 to 30 dB": "paper", "15 to 20 dB": "paper_dim"}
"""Where the paper has figures, and which of a row's they are."""
JUDGED = {
    "15 to 30 dB": photons(71.0, 2240.0),  # 20 counts are 9.5 dB of signal energy over noise energy, see `snr.py`
    "15 to 20 dB": photons(71.0, 224.0),
    "all conditions": DatasetSettings(seed=4, scenes=48, degradations=1, held_out=True, **SMALL),
}
SURROGATE = ("cycles",)
"""Motorcycles and bicycles: what comes nearest to the paper's 277 motorcycles, and no more than that."""


def printed_loss(total_variation: float) -> LossSettings:
    """MSE + lambda TV."""
    return LossSettings(picture=10.0, depth=0.0, total_variation=total_variation)


PRINTED_LOSS = printed_loss(0.3)
OWN_LOSS = LossSettings(picture=5.0, log_picture=0.06, depth=2.0)
RATE = 1e-3
Paper = Mapping[str, float]


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


PASSES = "Passes of the printed network (paper: table VII)"
TABLES: dict[str, tuple[Row, ...]] = {
    "Parts of the printed network (paper: table III)": (
        Row("I: no lifting, no projection, no NLE", switches={"lifting": "none", "projection": False} | NO_NLE,
            paper=printed(25.34, 0.87, 0.126, 0.031), paper_dim=printed(23.49, 0.84, 0.176, 0.053)),
        Row("II: MLP lifting, no NLE", switches={"lifting": "mlp"} | NO_NLE, paper=printed(24.68, 0.85, 0.103, 0.053),
            paper_dim=printed(24.33, 0.81, 0.125, 0.050)),
        Row("III: both liftings, no NLE", switches=NO_NLE, paper=printed(26.21, 0.87, 0.082, 0.030),
            paper_dim=printed(25.71, 0.82, 0.085, 0.031)),
        Row("IV: no SFE", switches={"sfe": False}, paper=printed(26.48, 0.87, 0.070, 0.025),
            paper_dim=printed(26.54, 0.84, 0.073, 0.030)),
        Row("V: whole", paper=printed(28.09, 0.90, 0.065, 0.021), paper_dim=printed(28.06, 0.88, 0.065, 0.023)),
    ),
    "Parts of the printed network, H fixed at -1.4 where the noise is not told (paper: table III)": (
        Row("I: no lifting, no projection, no NLE", switches=fixed(-1.4) | {"lifting": "none", "projection": False},
            paper=printed(25.34, 0.87, 0.126, 0.031), paper_dim=printed(23.49, 0.84, 0.176, 0.053)),
        Row("II: MLP lifting, no NLE", switches=fixed(-1.4) | {"lifting": "mlp"},
            paper=printed(24.68, 0.85, 0.103, 0.053), paper_dim=printed(24.33, 0.81, 0.125, 0.050)),
        Row("III: both liftings, no NLE", switches=fixed(-1.4), paper=printed(26.21, 0.87, 0.082, 0.030),
            paper_dim=printed(25.71, 0.82, 0.085, 0.031)),
        Row("V: whole", paper=printed(28.09, 0.90, 0.065, 0.021), paper_dim=printed(28.06, 0.88, 0.065, 0.023)),
    ),
    "Lifting of the printed network (paper: table IV)": (
        Row("none", switches={"lifting": "none"}),
        Row("I: global alone", switches={"lifting": "global"}, paper=printed(25.66, 0.86, 0.091, 0.028)),
        Row("II: local alone", switches={"lifting": "local"}, paper=printed(25.93, 0.86, 0.085, 0.029)),
        Row("III: both", paper=printed(28.09, 0.90, 0.065, 0.021)),
    ),
    "Loss (paper: table V), on NANO with lifting and SFE: an argmax has no gradient for a depth loss": (
        Row("I: albedo", "nano", loss=LossSettings(depth=0.0), paper=printed(28.03, 0.89, 0.093, 0.036)),
        Row("II: albedo and depth", "nano", loss=LossSettings(), paper=printed(26.92, 0.81, 0.070, 0.022)),
        Row("III: albedo, depth and TV", "nano", loss=LossSettings(total_variation=30.0),
            paper=printed(27.58, 0.87, 0.068, 0.025)),
        Row("IV: albedo and TV", "nano", loss=LossSettings(depth=0.0, total_variation=30.0),
            paper=printed(28.09, 0.90, 0.065, 0.021)),
    ),
    PASSES: tuple(
        Row(f"S = {s}", switches={"outer_iterations": s} if s > 1 else {}, paper=printed(psnr, ssim))
        for s, psnr, ssim in (
            (6, 28.36, 0.910), (5, 28.22, 0.905), (4, 28.21, 0.902), (3, 28.21, 0.885), (2, 28.26, 0.886),
            (1, 27.98, 0.881),
        )
    ),
    "Readings of what the paper leaves open (this project)": (
        Row("way up: transposed convolution", switches={"prolongation": "transposed"}),
        Row("scales by truncation", switches={"restriction": "truncation"}),
        Row("u(0) = 0", switches={"start": "zero"}),
        Row("u_g = H* tau", switches={"guide": "adjoint"}),
        Row("spectrum over z", switches={"depth_axis": "metric"}),
        Row("PReLU in NLO", switches={"operator_activation": "prelu"}),
        Row("whitened spectrum", switches={"whiten": True}),
        Row("bandwidth 64", switches={"sfe_bandwidth": 64}),
        Row("told by the estimate of any noise", switches={"noise_estimate": "any_kind"}),
        Row("H fixed at -1.0", switches={"transport": "fixed"}),
        Row("H fixed at -1.0, no NLE", switches={"transport": "fixed"} | NO_NLE),
        Row("H fixed at -1.4, no NLE", switches=fixed(-1.4)),
        Row("H fixed at -1.8, no NLE", switches=fixed(-1.8)),
        Row("a = 10 always", noise_least=10.0),
        Row("no total variation", loss=printed_loss(0.0)),
        Row("ten times the total variation", loss=printed_loss(3.0)),
        Row("SFE beside NLO", switches={"sfe_place": "beside"}),
        Row("NLO with kernels of 3", switches={"operator_kernel": 3}),
        Row("one MLP of eta for all scales", switches={"embedding": "shared"}),
        Row("eta^ beside F_st", switches={"meeting": "concatenated"}),
        Row("M drawn anew every step", switches={"sfe_redrawn": True}),
        Row("as printed"),
    ),
    "NANO with all of the paper's parts, without one (this project)": (
        Row("no SFE", "nano", {"sfe": False}, OWN_LOSS),
        Row("no lifting", "nano", {"lifting": "none"}, OWN_LOSS),
        Row("no noise estimation", "nano", {"nle": False}, OWN_LOSS),
        Row("no spectral updates", "nano", {"spectral_scales": 0}, OWN_LOSS),
        Row("no projection, the bare maximum", "nano", {"projection": False}, OWN_LOSS),
        Row("whole", "nano", {}, OWN_LOSS),
    ),
    "NANO as it ships, without one part (this project)": (
        Row("no volume with empty gaps", WITHOUT, SHIPS | {"without": "empty gaps"}, OWN_LOSS),
        Row("no 2D network, attention alone", WITHOUT, SHIPS | {"without": "2D network"}, OWN_LOSS),
        Row("no noise estimation", "nano", SHIPS | {"nle": False}, OWN_LOSS),
        Row("no spectral updates", "nano", SHIPS | {"spectral_scales": 0}, OWN_LOSS),
        Row("as it ships", "nano", SHIPS, OWN_LOSS),
    ),
    "NANO as it ships, without one part or with one that left it: four times the samples, two a step (this project)": (
        longer("with SFE and both liftings", {"lifting": "both", "sfe": True}),
        longer("with SFE", {"sfe": True}),
        longer("with both liftings", {"lifting": "both"}),
        longer("no volume with empty gaps", {"without": "empty gaps"}, WITHOUT),
        longer("no 2D network, attention alone", {"without": "2D network"}, WITHOUT),
        longer("no projection, the bare maximum", {"projection": False}),
        longer("no noise estimation", {"nle": False}),
        longer("no spectral updates", {"spectral_scales": 0}),
        longer("as it ships", {}),
    ),
    "Rivals at equal samples (this project)": (
        Row("light-cone transform", "lct"), Row("the printed network"), *rivals("samples"),
    ),
    "Rivals at equal samples, against the printed network (this project)": (
        *rivals("samples"), Row("the printed network"),
    ),
    "Rivals at equal seconds of training (this project)": rivals("seconds"),
    "Rivals at equal parameters, 1.1 to 1.2 million (this project)": rivals("parameters"),
    "Rivals given what NANO has: gaps filled as well as empty, the mean over mirror images (this project)": (
        given("lfe", False), given("lfe", True), given("nlost", False), given("nlost", True), given("unet", False),
        given("unet", True), Row("the printed network, mirrored", mirrored=True),
        Row("NANO, mirrored", "nano", SHIPS, OWN_LOSS, mirrored=True),
    ),
    "LFE's rate (this project)": (
        Row("0.0005", "lfe", NEAR, OWN_LOSS, rate=0.0005), Row("0.0045", "lfe", NEAR, OWN_LOSS, rate=0.0045),
        Row("0.0015, as in other tables", "lfe", NEAR, OWN_LOSS, rate=RIVALS_RATE),
    ),
    "Cycles alone, a surrogate of the paper's data: margins only (this project)": (
        Row("light-cone transform", "lct", kinds=SURROGATE), Row("the printed network", kinds=SURROGATE),
        *rivals("samples", SURROGATE),
    ),
    "Cycles alone, against the printed network: margins only (this project)": (
        *rivals("samples", SURROGATE), Row("the printed network", kinds=SURROGATE),
    ),
}  # fmt: skip


def settings_of(row: Row, samples: int, seed: int) -> TrainSettings:
    """The training of one row: only what the row names differs from the others of its method."""
    own = {"noise_weights": "nano"} if row.method in OURS else {}
    samples = round(samples * row.times)
    return TrainSettings(
        method=row.method,
        method_settings=own | (WHOLE if row.method == "nano" else {}) | row.switches,
        data=DatasetSettings(seed=1, scenes=samples, degradations=1, kinds=row.kinds, **SMALL),
        validation=WATCHED,
        loss=row.loss,
        seed=seed,
        samples=samples,
        batch=row.batch,
        learning_rate=row.rate,
        average=0.998,
        cache=str(FOLDER / "scenes"),
        uniform_noise_least=row.noise_least,
        uniform_noise_most=10.0 if row.method == "faithful" else 0.0,
        workers=0 if torch.cuda.is_available() else None,  # trainings side by side on a GPU have a core each
    )


def judged_on(row: Row, sets: Mapping[str, DatasetSettings]) -> dict[str, DatasetSettings]:
    """`sets`, of the row's kinds of scenes where it has some."""
    if not row.kinds:
        return dict(sets)
    return {name: data.model_copy(update={"held_out": False, "kinds": row.kinds}) for name, data in sets.items()}


def folder_of(row: Row, samples: int, seed: int) -> Path:
    """Where it is trained. Rows that are the same in two tables are trained once."""
    return FOLDER / _name(row, samples, seed)


def kept_of(row: Row, samples: int, seed: int) -> Path:
    """The file with its figures."""
    folder = KEPT / "mirrored" if row.mirrored else KEPT
    return folder / _name(row, samples, seed).with_suffix(".json")


def _name(row: Row, samples: int, seed: int) -> Path:
    words = [Path(row.method).stem, *(f"{key}-{value}" for key, value in sorted(row.switches.items()))]
    words += [f"{key}-{value:g}" for key, value in row.loss.model_dump(exclude_defaults=True).items()]
    words += [f"rate-{row.rate:g}"] if row.rate != RATE else []
    words += [f"times-{row.times:g}"] if row.times != 1 else []
    words += [f"batch-{row.batch}"] if row.batch != 1 else []
    words += [f"noise-from-{row.noise_least:g}"] if row.noise_least else []
    words += [*row.kinds]
    return Path(f"{samples}-{FORM}") / "_".join(words).replace(" ", "") / f"seed-{seed}"


def in_order(samples: int, seeds: tuple[int, ...] = SEEDS) -> list[tuple[Row, int]]:
    """What is judged, each once: all rows of the first seed before any of the second, the dearest last."""

    def cost(row: Row) -> int:
        return int(row.switches.get("outer_iterations", 1))

    rows = sorted((row for rows in TABLES.values() for row in rows), key=cost)
    unique = {kept_of(row, samples, seed): (row, seed) for seed in seeds for row in rows}
    return list(unique.values())

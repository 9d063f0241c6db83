"""The rows of the paper's tables, and of what ships without one part: each a training of its own."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.losses import LossSettings
from nlos.recon.training.train_settings import TrainSettings
from studies.row import (
    NEAR,
    NO_NLE,
    OURS,
    OWN_LOSS,
    RATE,
    RIVALS_RATE,
    SHIPS,
    SURROGATE,
    WHOLE,
    WITHOUT,
    Row,
    fixed,
    given,
    longer,
    printed,
    printed_loss,
    rivals,
)

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

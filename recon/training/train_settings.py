"""What a training configuration says: the method, its data, and the recipe."""

from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from nlos.configs.settings import Settings
from nlos.recon.training.dataset import DatasetSettings
from nlos.recon.training.losses import LossSettings


class TrainSettings(Settings):
    """One training. Length counts samples, so that methods can be compared at equal numbers seen.

    The schedule is a warm-up, then a cosine from `learning_rate` to `last_rate`. The defaults are the recipe that
    trained best on two cores (docs/decisions).
    """

    method: str
    method_settings: dict[str, Any] = Field(default_factory=dict)
    data: DatasetSettings = DatasetSettings()
    validation: DatasetSettings = DatasetSettings(seed=2, scenes=32, degradations=1, held_out=True)
    loss: LossSettings = LossSettings()
    seed: int = 1
    samples: int = 6000
    batch: int = 2
    learning_rate: float = 2e-3
    last_rate: float = 4e-5
    warm_up_steps: int = 100
    weight_decay: float = 1e-4
    clip: float = 1.0
    average: float = 0.995  # of the weights, running
    flips: bool = True
    pooled_share: float = 0.0  # of the steps that see wall points added 2 x 2: a scan on half the grid
    precision: Literal["auto", "float32", "bf16"] = "auto"
    start_from: str | None = None  # weights to begin with
    checkpoint_minutes: float = 2.0
    max_minutes: float | None = None  # stops there, resumable
    tensorboard: bool = False  # beside the log; needs the extra of that name
    cache: str | None = (
        "runs/scenes"  # the folder where rendered samples are kept; null keeps none, for scenes seen once
    )

    @property
    def cache_path(self) -> Path | None:
        return None if self.cache is None else Path(self.cache)

    @property
    def steps(self) -> int:
        return -(-self.samples // self.batch)

"""What a training configuration says: the method, its data, and the recipe."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from nlos.configs.settings import Settings
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.losses import LossSettings

GEOMETRY = ("wall_width_m", "rows", "cols", "bins", "bin_width_ps", "retroreflective")
"""What `validation` takes over from `data`: the network is built for one grid and sees both."""
Above0 = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class TrainSettings(Settings):
    """One training. Length counts samples, so that methods can be compared at equal numbers seen.

    The schedule is a warm-up, then a cosine or an exponential from `learning_rate` to `last_rate`. The defaults are the
    recipe that trained best on two cores.
    """

    method: str
    """The method that is trained: `nlos methods`."""
    method_settings: dict[str, Any] = Field(default_factory=dict)
    """Its settings; those of the weights in `start_from` unless given."""
    data: DatasetSettings = DatasetSettings()
    """The scenes that are learned from."""
    validation: DatasetSettings = DatasetSettings(seed=2, scenes=32, degradations=1, held_out=True)
    """The scenes that it is judged by while it learns; on the grid of `data`."""
    loss: LossSettings = LossSettings()
    """What is minimised."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of the order of samples and of the first weights."""
    samples: Annotated[int, Field(ge=1)] = 6000
    """How many samples are seen; rounded up to whole batches."""
    batch: Annotated[int, Field(ge=1, le=4096)] = 2
    """Samples per step."""
    learning_rate: Above0 = 2e-3
    """Learning rate after the warm-up."""
    last_rate: Above0 = 4e-5
    """Learning rate at the end."""
    warm_up_steps: Annotated[int, Field(ge=0)] = 100
    """Steps over which the rate rises."""
    schedule: Literal["cosine", "exponential"] = "cosine"
    """How the rate falls afterwards."""
    weight_decay: Annotated[float, Field(ge=0)] = 1e-4
    """Of AdamW."""
    clip: Above0 = 1.0
    """Largest norm of the gradient."""
    average: Annotated[float, Field(ge=0, lt=1)] = 0.995
    """Running average of the weights: the part that is kept at each step."""
    flips: bool = True
    """Turn samples over at random."""
    uniform_noise_least: Annotated[float, Field(ge=0)] = 0.0
    """The smallest a of `uniform_noise_most`; the same number for both is that a always."""
    uniform_noise_most: Annotated[float, Field(ge=0)] = 0.0
    """The largest a of the uniform noise U(0, a) drawn afresh every step, where a scan's brightest bin is 255."""
    pooled_share: Share = 0.0
    """Part of the steps that see wall points added 2 x 2: a scan on half the grid."""
    precision: Literal["auto", "float32", "bf16"] = "auto"
    """Precision of the arithmetic; bf16 on GPUs that have it by default."""
    start_from: str | None = None
    """Weights to begin with: a file, or a name of those that ship. Their architecture comes with them."""
    checkpoint_minutes: Above0 = 0.5
    """Minutes between two states on disk; more where saving one would take over a twentieth of the time."""
    max_minutes: Above0 | None = None
    """Stops after the step under way then, and validates; the same command resumes."""
    workers: Annotated[int, Field(ge=0, le=256)] | None = None
    """Processes that make samples, each on one core; by default 1 on a CPU, the spare cores beside a GPU, and none for
    short runs. The run is the same."""
    tensorboard: bool = False
    """Also write TensorBoard logs; needs the extra of that name."""
    licence: str = "not stated"
    """Of the weights: what their file says about how others may use them."""
    cache: str | None = (
        "runs/scenes"  # the folder where rendered samples are kept; null keeps none, for scenes seen once
    )
    """Folder where rendered samples are kept; none for scenes seen once."""

    @model_validator(mode="after")
    def _inherited(self) -> Self:
        """`validation` has the grid of `data`, where it says none."""
        missing = {key: getattr(self.data, key) for key in GEOMETRY if key not in self.validation.model_fields_set}
        object.__setattr__(self, "validation", self.validation.model_copy(update=missing))
        return self

    @model_validator(mode="after")
    def _noise_in_order(self) -> Self:
        if self.uniform_noise_least > self.uniform_noise_most:
            raise ValueError(
                f"uniform_noise_least {self.uniform_noise_least:g} is above uniform_noise_most "
                f"{self.uniform_noise_most:g}: a is drawn between them"
            )
        return self

    @property
    def cache_path(self) -> Path | None:
        return None if self.cache is None else Path(self.cache)

    @property
    def steps(self) -> int:
        return -(-self.samples // self.batch)

    @property
    def seen(self) -> int:
        """Samples at the end: whole batches."""
        return self.steps * self.batch

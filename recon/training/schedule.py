"""When a training does what: its learning rate at every step, and the steps after which it is validated."""

import math

from nlos.recon.training.train_settings import TrainSettings

RISES = 1.5
"""Times the rate before: of less the user does not hear."""


def learning_rate(settings: TrainSettings, step: int) -> float:
    """Linear warm-up, then half a cosine or a steady decay."""
    if step < settings.warm_up_steps:
        return settings.learning_rate * (step + 1) / settings.warm_up_steps
    done = (step - settings.warm_up_steps) / max(1, settings.steps - settings.warm_up_steps)
    if settings.schedule == "exponential":
        return float(settings.learning_rate * (settings.last_rate / settings.learning_rate) ** done)
    return settings.last_rate + (settings.learning_rate - settings.last_rate) * (1 + math.cos(math.pi * done)) / 2


def rate_rises(settings: TrainSettings, step: int, before: float | None) -> str:
    """What to know where a run is extended, whose schedule is stretched: the rate rises again. Empty elsewhere."""
    now = learning_rate(settings, step)
    if before is None or step < settings.warm_up_steps or now < RISES * before:
        return ""
    return (
        f"the schedule now ends at step {settings.steps}: the learning rate rises again, from {before:.2g} to "
        f"{now:.2g}, and the loss may for a while; the best weights so far are kept"
    )


def whole_batches(settings: TrainSettings) -> str:
    """What to know where the samples are no whole number of batches: empty where they are."""
    if settings.samples % settings.batch == 0:
        return ""
    return f"; {settings.samples:,} samples are no whole batches of {settings.batch}: {settings.seen:,} are seen"


def validation_steps(steps: int) -> set[int]:
    """When a network in training is validated: early and often at first, then at every fifth of the way."""
    return {math.ceil(steps * part) for part in (0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8)}

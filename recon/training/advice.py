"""What a training file says that its author may not have meant: said before the first step, and not refused."""

from nlos.recon.methods import find
from nlos.recon.training.train_settings import TrainSettings


def advice(settings: TrainSettings) -> list[str]:
    """A sentence each. Raises `InvalidSettings` for a method that there is not."""
    known, given = find(settings.method).Settings.model_fields, settings.method_settings
    if "noise_weights" not in known or settings.start_from is not None or given.get("stage") == "noise":
        return []
    if given.get("noise_weights") is not None:
        return []
    return [
        f"how noisy a scan is {settings.method} will tell by a network that nobody trained: name weights for it, "
        f"`method_settings: {{noise_weights: nano}}`, or begin with some (`start_from`)"
    ]

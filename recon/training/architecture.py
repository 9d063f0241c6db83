"""The settings of the method that is trained: those of the weights it begins with, and before them the file's own."""

import json
from typing import Any

from nlos.configs.settings import Settings
from nlos.recon.methods import find
from nlos.recon.own_methods import in_a_file
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.described import OF_TRAINING, describe_weights
from nlos.recon.weights.files import WeightsError


def method_settings(settings: TrainSettings) -> Settings:
    """Every setting of the method, without weights. Raises pydantic's ValidationError."""
    given = json.dumps({"weights": None} | _begun_with(settings) | settings.method_settings)
    return find(settings.method).Settings.model_validate_json(given)


def _begun_with(settings: TrainSettings) -> dict[str, Any]:
    """The architecture of the weights that a training begins with; empty where they do not say one of this method."""
    if settings.start_from is None:
        return {}
    try:
        known = describe_weights(settings.start_from, settings.method if in_a_file(settings.method) else None)
    except WeightsError:
        return {}
    if known.method != settings.method:
        return {}
    return {key: value for key, value in known.settings.items() if key not in OF_TRAINING}

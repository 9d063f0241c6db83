"""Who takes part in an evaluation: methods of the catalogue, of a file, or with weights of one's own."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nlos.acquisition.transient import Transient
from nlos.recon.errors import InvalidSettings
from nlos.recon.methods import find, parse_settings
from nlos.recon.own_methods import in_a_file, name_of
from nlos.recon.physics_settings import PhysicsSettings

SNR_CHOICES = (1.0, 0.1, 0.03, 0.01, 0.003)


@dataclass(frozen=True)
class Entrant:
    """One method as it takes part: under its own name, or a user's weights under a name of theirs."""

    name: str
    method: str
    settings: dict[str, object]


def entrant(word: str) -> Entrant:
    """`METHOD`, a method's file, or `NAME=FILE` for weights or a method's file. Raises `InvalidSettings`."""
    name, equals, file = word.partition("=")
    if not equals:
        return Entrant(name_of(name), name, {})
    if not name or not file:
        raise InvalidSettings(f"--methods {word}: NAME=FILE is expected, a name and a file of weights or of a method")
    if in_a_file(file):
        return Entrant(name, file, {})
    from nlos.recon.weights.described import describe_weights

    known = describe_weights(file)
    return Entrant(name, known.method, known.settings)


def check_known(methods: Sequence[str], settings: dict[str, object]) -> None:
    """Raises `InvalidSettings` for a method that does not exist, and for a setting that none of them has."""
    known = sorted({key for method in methods for key in find(method).Settings.model_fields})
    for key in settings:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"
            raise InvalidSettings(f"none of {', '.join(methods)} has a setting '{key}'; {hint}")


def choices(
    method: str, settings: dict[str, object], fixed: bool, given: Mapping[str, object] | None = None
) -> list[dict[str, object]]:
    """The settings that a method is tried with: those of its weights (`given`), and before them `settings`."""
    known = find(method).Settings
    own = {**(given or {})} | {key: value for key, value in settings.items() if key in known.model_fields}
    parse_settings(method, own)
    tuned = issubclass(known, PhysicsSettings) and known.has_inverse_filter and not fixed and "snr" not in own
    return [{**own, "snr": snr} for snr in SNR_CHOICES] if tuned else [own]


def unlike_trained(one: Entrant, transient: Transient, falloff: float | None) -> str:
    """Where a scan lies outside of what an entrant's own weights were trained on, in words."""
    if "weights" not in one.settings:
        return ""
    from nlos.recon.weights.outside import outside_range

    return outside_range(one.settings["weights"], transient, falloff)


def learned_from(one: Entrant) -> frozenset[str]:
    """Fingerprints of the scenes on disk that its weights were trained on."""
    field = find(one.method).Settings.model_fields.get("weights")
    weights = one.settings.get("weights", None if field is None else field.default)
    if not isinstance(weights, str):
        return frozenset()
    from nlos.recon.weights.files import WeightsError, find_weights, read_about

    try:
        return frozenset(read_about(find_weights(weights)).get("learned_from", ()))
    except WeightsError:
        return frozenset()  # said where they are used

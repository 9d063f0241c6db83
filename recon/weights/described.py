"""What weights say about themselves: the method and architecture they are of, what they saw, and how good they were.

Written by training into the file's `about`, next to what older files already hold:
`method`; `architecture` (every setting of the method); `settings` (the training file); `samples`, `step`, `hours`;
`validation` (figures on scenes of kinds never trained on); `range` (points, wall, bins, response, photons); `licence`.
"""

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from nlos.recon.methods import catalogue, find
from nlos.recon.own_methods import in_a_file, name_of
from nlos.recon.weights.files import (
    OWN_FOLDER,
    STUDIES,
    WeightsError,
    find_weights,
    is_training_state,
    read_about,
    refuse_training_state,
    sha256_of,
)

log = logging.getLogger(__name__)
OF_TRAINING = ("weights", "noise_weights")
"""Settings that name other files; weights hold every parameter, so these are not needed to use them."""
PROJECT_LICENCE = "BSD-3-Clause"


@dataclass(frozen=True)
class Description:
    """Weights, and the method with the settings that they are used by."""

    path: Path
    method: str
    settings: dict[str, object]
    """Of the method: its architecture, and `weights`."""
    about: dict[str, Any]


def describe_weights(name: str, file: str | None = None) -> Description:
    """What the weights `name` (a file, or a name of those that ship) are of. Weights of a method in a file need that
    `file` named: what weights say is never run.

    Raises `WeightsError` for a file that does not say so, or that says what no method of the catalogue is.
    """
    path = find_weights(name)
    refuse_training_state(path)
    about = read_about(path)
    method = about.get("method")
    if isinstance(method, str) and in_a_file(method):
        if file is None or name_of(file) != name_of(method):
            raise WeightsError(f"{path} is of the method in a file {name_of(method)}. Name it with --method FILE.")
        method = file
        return Description(path, method, _architecture(path, method, about) | {"weights": str(path)}, about)
    if method is None:
        raise WeightsError(
            f"{path} does not say which method it is of. Name it with --method, and its architecture with --set."
        )
    if method not in catalogue():
        raise WeightsError(f"{path} is of the method {method!r}, which this version does not have.")
    return Description(path, method, _architecture(path, method, about) | {"weights": str(path)}, about)


def use_weights(
    weights: str | Path | None, method: str | None, settings: Mapping[str, object], default: str = "lct"
) -> tuple[str, dict[str, object]]:
    """The method and its settings, with those of `weights` where they are given; `settings` go before them.

    Raises `WeightsError` where `method` is another than the weights'.
    """
    if weights is None:
        return method or default, dict(settings)
    path = find_weights(str(weights))
    if method is not None and "method" not in read_about(path):  # another program's: what was said is all there is
        return method, {**settings, "weights": str(path)}
    known = describe_weights(str(weights), method if method is not None and in_a_file(method) else None)
    if method not in (None, known.method):
        raise WeightsError(f"{known.path} is of the method {known.method}, not of {method}. Leave the method out.")
    return known.method, {**known.settings, **settings}


def _architecture(path: Path, method: str, about: Mapping[str, Any]) -> dict[str, object]:
    """The method's settings as the file says them, as Python values. Raises `WeightsError`."""
    kind = find(method).Settings
    trained = about.get("settings", {})
    said = about.get("architecture", trained.get("method_settings", trained))
    if not isinstance(said, dict):
        raise WeightsError(f"{path}: its settings are not readable. Copy or train it again.")
    known = {key: value for key, value in said.items() if key in kind.model_fields and key not in OF_TRAINING}
    if said.get("stage") == "noise":
        raise WeightsError(
            f"{path} holds noise level estimation alone, which makes no picture. Name it as `noise_weights` in a "
            "training file."
        )
    unknown = sorted(said.keys() - kind.model_fields.keys())
    if unknown and path.parent not in (OWN_FOLDER, STUDIES):
        log.warning("%s: this version of %s has no %s", path, method, ", ".join(unknown))
    nothing = {key: None for key in OF_TRAINING if key in kind.model_fields}
    try:
        chosen = kind.model_validate_json(json.dumps(known | nothing))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise WeightsError(f"{path}: {method}: {key}: {first['msg']}. Copy or train it again.") from None
    settings = chosen.model_dump()
    if "falloff" not in known or known["falloff"] == kind.model_fields["falloff"].default:
        settings.pop("falloff", None)  # the scan's to say
    return settings


def summary(name: str) -> dict[str, Any]:
    """What a person wants to know of weights, as plain values: `nlos info` shows it. Raises `WeightsError`."""
    path = find_weights(name)
    about = read_about(path)
    trained = about.get("settings", {})
    data = trained.get("data", about.get("data", "not stated")) if isinstance(trained, dict) else "not stated"
    state = is_training_state(path)
    found: dict[str, Any] = {"format": "training state" if state else "weights"}
    found["method"] = about.get("method", "not stated")
    if found["method"] in catalogue():
        found["architecture"] = {
            key: value for key, value in _architecture(path, found["method"], about).items() if key not in OF_TRAINING
        }
    if isinstance(data, dict) and not data.get("files"):
        data = {key: value for key, value in data.items() if key not in ("files", "share")}
    found["trained on"] = data
    if about.get("learned_from"):
        found["scenes on disk"] = len(about["learned_from"])
    found["for how long"] = how_long(about)
    found["validation"] = "of the weights: see weights.safetensors" if state else about.get("validation", "not stated")
    if (last := about.get("last")) is not None:
        found["at the run's end"] = f"{last['samples']:,} samples, psnr {last['psnr']:.3f}"
    if (parent := about.get("parent")) is not None:
        found["begun with"] = f"{parent['name']}, licence {parent['licence']}, sha256 {parent['sha256'][:12]}"
    found["range"] = about.get("range") or (range_of(data) if isinstance(data, dict) else "not stated")
    found["licence"] = licence_of(path, about)
    found["made by"] = {key: about[key] for key in ("commit", "torch", "device", "threads") if key in about}
    return found


def licence_of(path: Path, about: Mapping[str, Any]) -> str:
    """How others may use weights: what their file says; what ships has the project's licence."""
    shipped = path.parent in (OWN_FOLDER, STUDIES)
    return str(about.get("licence", PROJECT_LICENCE if shipped else "not stated"))


def parent_of(name: str) -> dict[str, str]:
    """What weights say of those that they began with: name, licence and content. Raises `WeightsError`."""
    path = find_weights(name)
    return {"name": name, "licence": licence_of(path, read_about(path)), "sha256": sha256_of(name)}


def how_long(about: Mapping[str, Any]) -> str:
    """Samples, steps and hours, and those of the weights that training began with."""
    if "samples" not in about:
        return "not stated"
    before = about.get("samples_before", 0)
    after = f", after {before:,} samples and {about.get('hours_before', 0.0):.2f} hours of others" if before else ""
    steps = about.get("step", 0)
    steps_ = f"{steps:,} step" + ("" if steps == 1 else "s")
    return f"{about['samples']:,} samples in {steps_}, {about.get('hours', 0.0):.2f} hours{after}"


def range_of(data: Mapping[str, Any]) -> dict[str, str]:
    """The measurements that were trained on, from a training file's `data`: what a scan should be like."""
    detector = data.get("detector", {})
    width_m, rows, cols = data["wall_width_m"], data["rows"], data["cols"]
    pitch_m = width_m / cols
    measured = data.get("impulse_responses", ())
    jitter_ps = detector.get("jitter_fwhm_most_ps")
    return {
        "points": f"{rows} x {cols}, {1000 * pitch_m:g} mm apart on {width_m:g} m",
        "bins": f"{data['bins']} of {data['bin_width_ps']:g} ps, {data['bins'] * data['bin_width_ps'] / 1000:g} ns",
        "response": f"{len(measured)} measured ones" if measured else f"up to {jitter_ps:g} ps FWHM"
        if jitter_ps is not None else "not stated",
        "photons": f"{detector['peak_counts_least']:g} to {detector['peak_counts_most']:g} counts at the peak, and "
        "noiseless" if "peak_counts_least" in detector else "not stated",
        "surfaces": "retroreflective" if data.get("retroreflective") else "diffuse",
    }  # fmt: skip

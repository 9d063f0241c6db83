"""Puts the weights of a finished run where the program finds them, with a card that says what they are.

`python -m nlos.recon.training.ship runs/train/lfe lfe [--study] [--half] [--unfinished]`, `--study` to put them into
studies/weights, outside the package.
"""

import json
import sys
from pathlib import Path
from typing import Any

from nlos.recon.training.run_folder import LOG, WEIGHTS
from nlos.recon.weights.files import OWN_FOLDER, STUDIES, WeightsError, read_weights, save

MOST_BYTES = 5_000_000
NOTE = """
Validation: scenes of the kinds that are held out from training, all measuring conditions mixed; PSNR at the best scale,
against the light-cone transform at the best of five snr for every single sample. Trained on simulated scenes only.
Made by `nlos train {name}` and `python -m nlos.recon.training.ship`.
"""


def ship(
    folder: Path, name: str, destination: Path = OWN_FOLDER, *, half: bool = False, unfinished: bool = False
) -> Path:
    """Write `destination`/`name`.safetensors and `name`.md from the run in `folder`; returns the weights' path.

    `half` stores half precision. Raises WeightsError for a run that is not finished, unless it may be `unfinished`, and
    for weights too large to ship.
    """
    weights = read_weights(folder / WEIGHTS)
    ends = [json.loads(line) for line in (folder / LOG).read_text().splitlines() if '"finished": ' in line]
    if not ends or not (ends[-1]["finished"] or unfinished):
        raise WeightsError(f"the run in {folder} is not finished. Run `nlos train` again; it resumes.")
    own = weights.about.get("validation", {})  # of these weights: the best, not the last
    about = weights.about | {
        "validation": own if "lct_psnr" in own else ends[-1]["validation"],
        "finished": ends[-1]["finished"],
        "half": half,
    }
    path = destination / f"{name}.safetensors"
    save(path, {key: x.half() if half else x for key, x in weights.tensors.items()}, about)
    if path.stat().st_size > MOST_BYTES:
        size = path.stat().st_size
        path.unlink()
        raise WeightsError(f"{size:,} bytes of weights; at most {MOST_BYTES:,} are shipped. Train a smaller network.")
    (destination / f"{name}.md").write_text(card(name, about, weights.tensors, path.stat().st_size))
    return path


def card(name: str, about: dict[str, Any], tensors: dict[str, Any], size: int) -> str:
    """The model card in Markdown."""
    settings, data, figures = about["settings"], about["settings"]["data"], about["validation"]
    count = sum(tensor.numel() for tensor in tensors.values())
    made = f"{data['scenes']:,} scenes x {data['degradations']} simulated measurements, seed {data['seed']}"
    grid = f"{data['rows']} x {data['cols']} points on {data['wall_width_m']:g} m, "
    grid += f"{data['bins']} bins of {data['bin_width_ps']:g} ps"
    recipe = f"AdamW, {settings['learning_rate']:g} to {settings['last_rate']:g}, batch {settings['batch']}, "
    recipe += f"weights averaged with {settings['average']:g}, "
    recipe += f"whole scans at half the grid in {settings['pooled_share']:.0%} of their steps"
    rows = {
        "method": f"`{about['method']}`, settings `{json.dumps(settings['method_settings'])}`",
        "parameters": f"{count:,} ({size:,} bytes{', half precision' if about.get('half') else ''})",
        "data": f"{made}; {grid}; kinds: {', '.join(data['kinds']) or 'all that are not held out'}",
        "samples seen": f"{about['samples']:,}{_of_all(about)} in {about['step']:,} steps, seed {settings['seed']}"
        + _before(about),
        "time": f"{about['hours']:.2f} hours on {about['device']}, threads: {about['threads']}, torch {about['torch']}",
        "recipe": recipe,
        "code": f"commit {about['commit']}",
        "validation": f"{settings['validation']['scenes']} scenes: PSNR {figures['psnr']:.2f} dB "
        f"(light cone {figures['lct_psnr']:.2f} dB), depth off by {1000 * figures['depth_mad_m']:.0f} mm on average",
    }
    table = "".join(f"| {key} | {text} |\n" for key, text in rows.items())
    return f"# {name}: weights of the method `{about['method']}`\n\n| | |\n|---|---|\n{table}" + NOTE.format(name=name)


def _of_all(about: dict[str, Any]) -> str:
    """What a run that was stopped was to see."""
    return "" if about.get("finished", True) else f" of {about['settings']['samples']:,}: stopped there,"


def _before(about: dict[str, Any]) -> str:
    samples, hours = about.get("samples_before", 0), about.get("hours_before", 0.0)
    if not samples:
        return ""
    name = Path(about["settings"]["start_from"]).parent.name
    return f", after {samples:,} samples and {hours:.2f} hours of the run `{name}`"


if __name__ == "__main__":
    said = set(sys.argv[3:])
    where = STUDIES if "--study" in said else OWN_FOLDER
    print(ship(Path(sys.argv[1]), sys.argv[2], where, half="--half" in said, unfinished="--unfinished" in said))

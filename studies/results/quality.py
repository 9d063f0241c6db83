"""Every method on every scene under every condition, by `nlos evaluate`'s own measure; kept between runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.recon.evaluate import Evaluation, Row, as_json, evaluate
from nlos.recon.evaluation_report import depth_span_m, gallery
from nlos.recon.metrics import image_scores
from nlos.recon.truth_scenes import Scene, find_scenes
from nlos.recon.volume import Reconstruction
from studies.results.kept import BASE, WEIGHTS_OF, kept, of_files, of_method, weights_path

PHYSICS = ("lct", "fk", "phasor", "gram", "backprojection")
LEARNED = ("lfe", "nlost", "unet", "faithful", *BASE, "nano")
CONDITIONS = (
    "transient",
    "counts_p20",
    "counts_p5",
    "counts_p1",
    "counts_p20@16x16",
    "counts_p5@16x16",
    "counts_p5@blue:256",
)
FEWER_AND_SLOWER = ("counts_p20@8x8", "counts_p20~100ps", "counts_p20~300ps", "counts_p20~600ps")
"""Of which only the margin is shown; both methods are told the response."""
ALL_PARTS: dict[str, object] = {"lifting": "both", "sfe": True}
AS_TRAINED: dict[str, dict[str, object]] = {
    "lfe_4000": {"farthest": 0.9},
    "nlost_4000": {"farthest": 0.9},
    "nano_4000": ALL_PARTS,
    "nano_4000_once": ALL_PARTS | {"symmetries": False},
    "nano_6500": ALL_PARTS,
}
"""Settings that weights were trained with, where they are not the method's own."""
THRESHOLD = 0.15  # of the maximum, taken off the light-cone transform's picture
THRESHOLDED = "lct - 15 %"


@dataclass(frozen=True)
class Quality:
    """Rows as `nlos evaluate` writes them, and the picture and depth behind each."""

    scenes: list[Scene]
    rows: list[dict[str, Any]]
    arrays: dict[tuple[str, str, str], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]


def trained(methods: Sequence[str]) -> list[str]:
    """Those that need no weights or have them."""
    return [method for method in methods if method not in LEARNED or weights_path(method).exists()]


def measure_quality(data: Path, methods: Sequence[str], conditions: Sequence[str]) -> Quality:
    """Means nothing but running it: what is kept is read, the rest is measured."""
    scenes = list(find_scenes([data], _quiet))
    files = of_files(scene.path for scene in scenes)
    quality = Quality(scenes, [], {})
    for condition in conditions:
        for method in methods:
            name = f"{data.name}-{method}-{condition.replace('@', '-')}"
            found = kept(name, of_method(method) | {"data": files}, lambda _, m=method, c=condition: _run(data, m, c))  # type: ignore[misc]
            for row in found.figures:
                quality.rows.append(row)
                key = row["scene"], row["method"], row["condition"]
                quality.arrays[key] = found.arrays[f"{row['scene']}/albedo"], found.arrays[f"{row['scene']}/depth"]
    return quality


def _run(data: Path, method: str, condition: str) -> tuple[Any, dict[str, npt.NDArray[np.float32]]]:
    named: dict[str, object] = (
        {"weights": WEIGHTS_OF.get(method, method)} | AS_TRAINED.get(method, {}) if method in BASE else {}
    )
    done = evaluate([data], [BASE.get(method, method)], [condition], settings=named, say=print)
    arrays: dict[str, npt.NDArray[np.float32]] = {}
    for (scene, _, _), picture in done.pictures.items():
        top = float(np.abs(picture.albedo).max()) or 1.0
        arrays |= {f"{scene}/albedo": picture.albedo / top, f"{scene}/depth": picture.depth_m}
    return [row | {"method": method} for row in as_json(done.rows)], arrays


def thresholded(quality: Quality) -> list[dict[str, Any]]:
    """SSIM of the light-cone transform with its noise floor cut off: the honest one to compare with."""
    truth = {scene.name: scene.intensity for scene in quality.scenes}
    rows = []
    for (scene, method, condition), (albedo, _) in quality.arrays.items():
        if method == "lct":
            cut = np.maximum(albedo - THRESHOLD * albedo.max(), 0)
            rows.append(
                {"scene": scene, "method": THRESHOLDED, "condition": condition, **image_scores(cut, truth[scene])}
            )
    return rows


def draw_gallery(quality: Quality, methods: Sequence[str], conditions: Sequence[str], path: Path) -> None:
    """Truth and methods, front view and depth."""
    rows = [
        Row(**{key: float("nan") if value is None else value for key, value in row.items()})  # type: ignore[arg-type]
        for row in quality.rows
        if row["method"] in methods and row["condition"] in conditions
    ]
    pictures = {}
    for row in rows:
        key = row.scene, row.method, row.condition
        wall = next(scene.wall for scene in quality.scenes if scene.name == row.scene)
        pictures[key] = Reconstruction(*quality.arrays[key], wall, row.method, row.seconds)
    path.parent.mkdir(parents=True, exist_ok=True)
    gallery(Evaluation(rows, quality.scenes, pictures), path)


def gallery_caption(scenes: Sequence[Scene]) -> str:
    """What `draw_gallery` shows, by which colours."""
    spans = ", ".join("{} {:.2f} to {:.2f} m".format(scene.name, *depth_span_m(scene)) for scene in scenes)
    return (
        "counts_p5 (5 counts in a point's brightest bin on average), front view and depth by each method. Front views: "
        "each over its own 99.9th percentile. Depths: metres from the wall, yellow is near, dark blue is far, grey "
        "is where nothing is seen; the colours of a row end 5 cm before the nearest and 5 cm behind the farthest "
        f"true point of its scene: {spans}."
    )


def _quiet(_: str) -> None:
    """Nothing is said of files without a truth."""

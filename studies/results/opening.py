"""What the page of results begins with: measured scenes by three methods, with figures that need no truth."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator

import nlos
from nlos.recon.metrics import correlation
from nlos.recon.pictures import scale_bar
from studies.results.kept import Kept, kept, of_files, of_method
from studies.results.tables import table

SCENES = {
    "statue_full": "statue, 4,096 points",
    "statue_random": "statue, 200 points",
    "statue_sparse": "statue, 100 points",
    "letter_2": "a letter",
    "letter_4": "another letter",
    "otoole_s_u": "S and U",
    "ahn_2019": "Ahn 2019",
    "ahn_toy": "Ahn, toy",
}
"""Files, and what they are called here."""
WHOLE = {"statue_random": "statue_full", "statue_sparse": "statue_full"}
"""Scans of few points, and the scan that they are points of."""
RESPONSE_PS = {"letter_2": 350.0, "letter_4": 350.0}
"""What is told beside the file: these authors do not say, their pulses are 300 to 400 ps wide."""
METHODS = {"lct": "LCT", "phasor": "phasor field", "nano": "NANO"}
PICTURE = "measured.png"
TITLE = "Hidden scenes measured by others: a column is one scan, a row is one method"
CAPTION = (
    "Front views, looking towards the wall; the brighter, the more light a point returned, each picture over its own "
    "99.9th percentile.\nWhat the scenes truly look like is not in the files: none of these pictures is the truth. "
    "200 and 100 points: parts of the statue's 4,096."
)


def seen(path: Path, method: str) -> Kept:
    """The front view over its 99.9th percentile, where its pixels are (m), and how much light it explains."""

    def measure(_: Path) -> tuple[dict[str, float | None], dict[str, npt.NDArray[np.float32]]]:
        picture = nlos.reconstruct(nlos.load(path), method, response=RESPONSE_PS.get(path.stem, "auto"))
        view = np.clip(picture.albedo / (float(np.quantile(picture.albedo, 0.999)) or 1.0), 0, 1)
        arrays = {"view": view, "x_m": picture.x_m.astype(np.float32), "y_m": picture.y_m.astype(np.float32)}
        return {"explained": picture.explained, "error": picture.explained_error}, arrays

    depends = {"data": of_files([path]), "response": RESPONSE_PS.get(path.stem)}
    return kept(f"opening-{path.stem}-{method}", of_method(method) | depends, measure)


def likeness(few: Kept, whole: Kept) -> float:
    """Correlation with the whole scan's picture, at the pixels of that of few points that lie within it."""
    y_m, x_m = whole.arrays["y_m"], whole.arrays["x_m"]
    at = RegularGridInterpolator((y_m[::-1], x_m), whole.arrays["view"][::-1], bounds_error=False, fill_value=np.nan)
    other = at(np.stack(np.meshgrid(few.arrays["y_m"], few.arrays["x_m"], indexing="ij"), axis=-1))
    within = np.isfinite(other)
    return correlation(few.arrays["view"][within], other[within])


def draw(found: dict[str, dict[str, Kept]], path: Path) -> None:
    """A row a method, a column a scan; every picture has the wall's shape, and a bar says how large that is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.3 * len(found), 1.3 * len(METHODS) + 1.05), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.02, wspace=0, hspace=0)  # type: ignore[union-attr, call-arg]
    grid = figure.subplots(len(METHODS), len(found), squeeze=False)
    for column, (name, methods) in enumerate(found.items()):
        for line, picture in zip(grid[:, column], methods.values(), strict=True):
            width_m, height_m = (_across(picture.arrays[axis]) for axis in ("x_m", "y_m"))
            extent = (-width_m / 2, width_m / 2, -height_m / 2, height_m / 2)
            line.imshow(picture.arrays["view"], cmap="gray", vmin=0, vmax=1, extent=extent)
            scale_bar(line, width_m, height_m, "white", 0.4)
            line.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])
        grid[0, column].set_title(SCENES[name].replace(", ", "\n" if name.startswith("statue") else " "), fontsize=8)
    for axes, label in zip(grid[:, 0], METHODS.values(), strict=True):
        axes.set_ylabel(label, fontsize=8)
    figure.suptitle(TITLE, fontsize=9)
    figure.supxlabel(CAPTION, fontsize=7, color="0.3")
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": "nlos"})


def _across(centres_m: npt.NDArray[np.float32]) -> float:
    """How wide so many pixels are, whose centres these are."""
    return float(abs(centres_m[-1] - centres_m[0])) * len(centres_m) / (len(centres_m) - 1)


def opening(data: Path, pictures: Path) -> str:
    """Draws the picture into `pictures`; the Markdown that shows it and says what light and other scans tell of it."""
    found = {name: {method: seen(data / f"{name}.h5", method) for method in METHODS} for name in SCENES}
    draw(found, pictures / PICTURE)
    body = [[SCENES[name], *(_told(found, name, method) for method in METHODS)] for name in SCENES]
    return "\n".join(
        [
            f"![measured scenes by {', '.join(METHODS.values())}]({pictures.name}/{PICTURE})\n",
            "Measured scenes as `nlos reconstruct FILE --method METHOD` shows them, each over its own 99.9th "
            "percentile; the letters with `--response 350`, which their files do not say. There is no truth to compare "
            "with. What there is: the share of photons that a picture was not made from and its surface explains "
            "([how sure a picture is](how-sure.md)), and, for a few points of the statue's scan, the correlation with "
            "the same method's picture of all of them.\n",
            table(["explained, %; correlation", *METHODS.values()], body),
        ]
    )


def _told(found: dict[str, dict[str, Kept]], name: str, method: str) -> str:
    one = found[name][method]
    share, error = one.figures["explained"], one.figures["error"]
    words = "-" if share is None else f"{100 * share:.1f} ± {100 * error:.1f}"
    if name in WHOLE:
        words += f"; {likeness(one, found[WHOLE[name]][method]):.2f}"
    return words

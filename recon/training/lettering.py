"""Letters and signs as coverage maps, from the fonts that matplotlib brings along."""

from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.ft2font import FT2Font

from nlos.recon.training.shapes import Array, Canvas

LETTER_FONTS = (
    "DejaVuSans-Bold",
    "DejaVuSans",
    "DejaVuSans-BoldOblique",
    "DejaVuSansMono-Bold",
    "DejaVuSerif-Bold",
    "DejaVuSerif-Italic",
    "STIXGeneralBol",
    "STIXGeneral",
    "cmb10",
    "cmss10",
    "cmtt10",
)
SIGN_FONTS = ("DejaVuSans-Bold", "STIXGeneral")
GLYPH_PIXELS = 160


@lru_cache(maxsize=2048)
def glyph(font: str, character: str) -> Array:
    """One character's ink in [0, 1], cut to its own box, GLYPH_PIXELS high em."""
    face = FT2Font(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"{font}.ttf"))
    face.set_size(GLYPH_PIXELS, 72)
    face.set_text(character)
    face.draw_glyphs_to_bitmap(antialiased=True)
    ink: Array = np.asarray(face.get_image(), dtype=np.float32) / np.float32(255)
    rows, cols = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    return ink[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]


def lettering(
    canvas: Canvas, character: str, font: str, centre: tuple[float, float], half_height: float, angle_rad: float
) -> Array:
    """Coverage (M, N) of one character around `centre`, `half_height` half-widths of the wall half high."""
    ink = glyph(font, character)
    height, width = ink.shape
    scale = height / (2 * half_height)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    dx, dy = canvas.x[None, :] - centre[0], canvas.y[:, None] - centre[1]
    col = (dx * cos + dy * sin) * scale + width / 2 - 0.5
    row = (dx * sin - dy * cos) * scale + height / 2 - 0.5
    padded = np.pad(ink, 1)
    i = np.clip(np.rint(row) + 1, 0, height + 1).astype(np.intp)
    j = np.clip(np.rint(col) + 1, 0, width + 1).astype(np.intp)
    return np.asarray(padded[i, j], dtype=np.float32)

"""The small parts of a report's HTML: tables, folded texts, pictures inside the page."""

import base64
import io
from html import escape
from typing import TYPE_CHECKING

from nlos.recon.png import write_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def table(rows: dict[str, str]) -> str:
    """Names and values, line by line."""
    lines = "".join(f"<tr><th scope=row>{escape(key)}</th><td>{escape(value)}</td></tr>" for key, value in rows.items())
    return f"<table>{lines}</table>"


def folded(name: str, text: str, how: str = "") -> str:
    """A text that opens when asked for."""
    return f"<details{how}><summary>{name}</summary><pre>{escape(text)}</pre></details>"


def number(value: object) -> str:
    """Four digits of a number, or of each in a list."""
    if isinstance(value, list):
        return ", ".join(number(item) for item in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def picture(figure: "Figure", caption: str, in_words: str = "") -> str:
    """A figure as a picture inside the page; `in_words` tells its figures to who cannot see it."""
    image = io.BytesIO()
    write_png(figure, image, 120)
    data = base64.b64encode(image.getvalue()).decode("ascii")
    alt = escape(f"{caption}; {in_words}" if in_words else caption)
    return (
        f'<figure><img alt="{alt}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )

"""What a picture is of, in small print: scan, method, points, photons, what it explains, time."""

from typing import TYPE_CHECKING

from nlos.recon.volume import Reconstruction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BETWEEN = " · "


def small_print(reconstruction: Reconstruction) -> str:
    """Scan, method, points, photons and computing time, as far as they are known."""
    made = reconstruction
    words = [made.made_from, made.method.upper()]
    if made.points:
        words += [f"{made.points:,} points", f"{si(made.photons)}indirect photons"]
    if made.explained is not None and made.explained.share is not None:
        words.append(made.explained.figure)
    return _BETWEEN.join(word for word in (*words, f"computed in {made.seconds:.1f} s") if word)


def below(figure: "Figure", text: str, points: float) -> None:
    """Small print of so many points below a figure, in lines that are no longer than it is wide."""
    text = drawable(text)
    most = 72 * 0.97 * float(figure.get_figwidth())
    lines: list[str] = []
    for paragraph in text.split("\n"):
        line = ""
        for piece in paragraph.split(_BETWEEN):
            together = f"{line}{_BETWEEN}{piece}" if line else piece
            if line and _long(together, points) > most:
                lines.append(line)
                together = piece
            line = together
            while _long(line, points) > most:  # a file's name alone
                fits = max(1, int(len(line) * most / _long(line, points)) - 1)
                lines.append(line[:fits])
                line = line[fits:]
        lines.append(line)
    figure.supxlabel("\n".join(lines), fontsize=points, color="0.35", parse_math=False)


def drawable(text: str) -> str:
    r"""`text` with every letter that the font of pictures lacks written as Python writes it, `\u6d4b`: a box may be any
    letter, and two scans would be called alike. A font of matplotlib's `font.family` that has them is drawn with."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties()))
    return "".join(
        letter if letter.isspace() or font.get_char_index(ord(letter)) else letter.encode("unicode_escape").decode()
        for letter in text
    )


def _long(text: str, points: float) -> float:
    """How long a line of it is, in points."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    # By what its letters advance: the outline of every one, as `TextPath` has it, took half of a picture's time.
    return float(text_to_path.get_text_width_height_descent(text, FontProperties(size=points), ismath=False)[0])


def si(number: float) -> str:
    """A large number for people, its unit to follow: 3.26 M."""
    for step, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= step:
            return f"{number / step:.3g} {letter} "
    return f"{number:.3g} "

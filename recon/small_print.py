"""What a picture is of, in small print: scan, method, points, photons, what it explains, time."""

from nlos.recon.volume import Reconstruction


def small_print(reconstruction: Reconstruction) -> str:
    """Scan, method, points, photons and computing time, as far as they are known."""
    made = reconstruction
    words = [made.made_from, made.method.upper()]
    if made.points:
        words += [f"{made.points:,} points", f"{si(made.photons)}indirect photons"]
    if made.explained is not None and made.explained.share is not None:
        words.append(made.explained.figure)
    return " · ".join(word for word in (*words, f"computed in {made.seconds:.1f} s") if word)


def si(number: float) -> str:
    """A large number for people, its unit to follow: 3.26 M."""
    for step, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if number >= step:
            return f"{number / step:.3g} {letter} "
    return f"{number:.3g} "

"""What a user whose file is in no known format is told: how to make one of it that is read."""

SAVED = "np.savez('scan.npz', histograms=counts, bin_width_s=16e-12, wall_size_m=(0.8, 0.8), rectified=False)"
"""One line of Python, with `counts` as below."""


def how_to_convert() -> str:
    """What to say to whoever's file cannot be read as it is."""
    return (
        f"In Python, read it your own way and save it once: {SAVED}, with counts [H, W, T], row 0 at the top and "
        "column 0 left, in seconds and metres. rectified=True: time 0 is the wall and direct light is gone."
    )


def of_objects() -> str:
    """What to say of NumPy's files that hold Python objects, of which a dict is one."""
    return (
        "holds Python objects (a dict, a list of arrays), which are not loaded: they may run programs. Where you made "
        f"it: np.load(FILE, allow_pickle=True), of a dict with .item(). {how_to_convert()}"
    )


def of_octave() -> str:
    """What to say of a file in one of GNU Octave's own formats, the default of its `save` among them."""
    return (
        "is in a format of GNU Octave's own. In Octave: x = load(FILE); save('-v7', 'scan.mat', '-struct', 'x'), and "
        "name scan.mat."
    )

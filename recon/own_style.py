"""Pictures in Matplotlib's own style, whatever a `matplotlibrc` or the program that asked says of others."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock

_WINDOWS = ("backend", "interactive", "toolbar")
"""Where figures are shown, which is the program's own business."""
_one_at_a_time = RLock()
"""What another thread would put back meanwhile is not what the program had set."""


@contextmanager
def own_style() -> Iterator[None]:
    """What is drawn within, or by the function that it decorates: rows from the top (`image.origin`), as wide as high,
    without LaTeX, which may not be there (`text.usetex`). What was set is set again afterwards.

    Matplotlib has one style for all threads, so that a program's other threads see ours meanwhile: in nothing but what
    they had set otherwise, and what they set meanwhile stays.
    """
    from matplotlib import rcParams, rcParamsDefault

    with _one_at_a_time:
        default = {name: value for name, value in rcParamsDefault.items() if name not in _WINDOWS}
        theirs = {name: rcParams[name] for name, value in default.items() if rcParams[name] != value}
        try:
            for name in theirs:
                rcParams[name] = default[name]
            yield
        finally:
            for name, value in theirs.items():
                if rcParams[name] == default[name]:
                    rcParams[name] = value

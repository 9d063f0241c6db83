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
    without LaTeX, which may not be there (`text.usetex`). What was set is set again afterwards."""
    import matplotlib

    default = {name: value for name, value in matplotlib.rcParamsDefault.items() if name not in _WINDOWS}
    with _one_at_a_time, matplotlib.rc_context(default):
        yield

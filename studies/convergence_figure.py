"""The figure of whether algorithm 1 converges (`convergence.py`)."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from studies.convergence import Contraction

LEAST_SHOWN = -6.5
"""log10 of the change from pass to pass; what is equal lies below."""


def figure(curves: dict[str, list[float]], found: "dict[str, Contraction]", path: Path) -> None:
    """The curves of relative changes beside the Lipschitz estimates, a panel a network: each has its own iterations."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(4.2 + 3.3 * len(found), 3.8), layout="constrained")
    left, *others = drawing.subplots(1, 1 + len(found), squeeze=False)[0]
    for k, (name, one) in enumerate(found.items()):
        left.plot(range(1, len(curves[name]) + 1), curves[name], "o-", color=f"C{k}", label=called(name, one))
        bars(others[k], called(name, one), one, f"C{k}")
    left.set(
        xlabel="pass s", ylabel="log10 of |u(s+1) - u(s)| / |u(s+1)|", title="Algorithm 1: change from pass to pass"
    )
    left.set_ylim(LEAST_SHOWN, 0.3)
    left.legend(fontsize=7)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, dpi=90)


def called(name: str, one: "Contraction") -> str:
    """A network's name in the figure, with what a reader has to know about it."""
    what = {"nano": "NANO, as it ships", "faithful": "faithful: the paper as printed"}.get(name, name)
    return what if one.lifting else f"{what}\n(B_l = 0: repeats the first pass, far below)"


def bars(axes: "Axes", name: str, one: "Contraction", colour: str) -> None:
    """One network's Lipschitz estimates, in the order in which a pass applies the parts."""
    heights = [one.lifting, *one.iterations, one.projection, one.whole_pass]
    names = ["$B_l$", *(f"$A_{{{j}}}$" for j in range(len(one.iterations))), "$B_p$", "$G$"]
    axes.bar(range(len(heights)), heights, color=colour)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.axhline(1.0, color="k", lw=0.8, ls="--", label="1: below it, a contraction")
    axes.set_ylabel("local Lipschitz estimate")
    axes.set_title(name, fontsize=8)
    axes.legend(fontsize=7)

"""Every target of the project as a row: what was asked for, what was reached, how far that is from it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies import paired
from studies.results.quality import THRESHOLDED
from studies.results.tables import FIGURES, of, shown, table, unique

Row = dict[str, Any]
FULL = ("transient", "counts_p20", "counts_p5", "counts_p1")
MARGINS = {
    "psnr": {
        "transient": 6.5,
        "counts_p20": 9.5,
        "counts_p5": 9.5,
        "counts_p1": 9.0,
        "counts_p20@16x16": 8.5,
        "counts_p5@16x16": 7.0,
        "counts_p5@blue:256": 7.5,
        "counts_p20@8x8": 6.0,
    },
    "psnr_max": {"transient": 5.0, "counts_p20": 7.0, "counts_p5": 7.0, "counts_p1": 7.0, "counts_p20@16x16": 6.0},
}
RESPONSES = {
    "psnr": {"counts_p20": 27.0, "counts_p20~100ps": 26.7, "counts_p20~300ps": 25.0, "counts_p20~600ps": 22.0},
    "depth_mad_m": {"counts_p20~300ps": 8.0, "counts_p20~600ps": 10.0},
}
"""What NANO is to reach where it is told the response."""
LEAST = {"transient": 21.6, "counts_p20": 21.0, "counts_p5": 20.4, "counts_p1": 19.4, "counts_p20@16x16": 19.0}
SPARSE = ("counts_p20@16x16", "counts_p5@16x16", "counts_p5@blue:256")
RIVALS_AT = (*FULL, *SPARSE)  # every condition that is evaluated
FOUR = ("psnr", "ssim", "depth_rmse_m", "depth_mad_m")

COMPARED = (
    " `a ± e` is a mean difference over the scenes, paired, with its standard error, at the condition that speaks "
    f"least for NANO: such a target is met only where it holds with {paired.TOLD:g} e to spare; 1.34 ± 0.68 does not "
    "meet >= 0."
)
"""How rows that compare are judged."""


@dataclass(frozen=True)
class Target:
    """`group` names the remarks that belong to it when it is missed."""

    group: str
    what: str
    wanted: float
    at_least: bool
    reached: float | None
    unit: str
    digits: int = 2
    error: float = 0.0
    """Standard error of what was reached, where it is compared: two of them have to be to spare."""

    @property
    def met(self) -> bool | None:
        """None where nothing was measured."""
        if self.reached is None:
            return None
        spare = paired.TOLD * self.error
        return self.reached - spare >= self.wanted if self.at_least else self.reached + spare <= self.wanted

    def line(self) -> list[str]:
        sign = ">=" if self.at_least else "<="
        verdict = {True: "met", False: "missed", None: "not measured"}[self.met]
        gap = "-" if self.reached is None else f"{self.reached - self.wanted:+.{self.digits}f}"
        wanted = f"{sign} {self.wanted:g} {self.unit}".strip()
        reached = shown(self.reached, self.digits) + (f" ± {self.error:.{self.digits}f}" if self.error else "")
        return [self.what, wanted, reached, gap, verdict]


def difference(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other


def of_quality(rows: Sequence[Row], thresholded: Sequence[Row]) -> list[Target]:
    """Margins, robustness and depth of NANO on the rendered scenes, told the response where there is one."""

    def nano(condition: str, figure: str = "psnr") -> float | None:
        return of(rows, "nano", condition, figure)

    found = []
    for figure, name in (("psnr", "PSNR"), ("psnr_max", "PSNR by maximum")):
        for condition, wanted in MARGINS[figure].items():
            margin = difference(nano(condition, figure), of(rows, "lct", condition, figure))
            found.append(Target("margin", f"{name} over tuned lct, {condition}", wanted, True, margin, "dB"))
    for condition, wanted in RESPONSES["psnr"].items():
        found.append(Target("response", f"PSNR, {condition}", wanted, True, nano(condition), "dB"))
    for condition, wanted in RESPONSES["depth_mad_m"].items():
        mad = nano(condition, "depth_mad_m")
        found.append(Target("response", f"depth MAD, {condition}", wanted, False, mad and 1e3 * mad, "mm", 1))
    for condition in RIVALS_AT:
        margin = difference(nano(condition, "ssim"), of(thresholded, THRESHOLDED, condition, "ssim"))
        found.append(Target("ssim", f"SSIM over lct less 15 % of its maximum, {condition}", 0, True, margin, "", 3))
    for condition, wanted in LEAST.items():
        found.append(Target("least", f"PSNR by maximum, {condition}", wanted, True, nano(condition, "psnr_max"), "dB"))
    loss = difference(nano("transient"), nano("counts_p20"))
    found.append(Target("noise", "PSNR lost from transient to counts_p20", 0.1, False, loss, "dB"))
    loss = difference(nano("counts_p20"), nano("counts_p1"))
    found.append(Target("photons", "PSNR lost from counts_p20 to counts_p1", 1, False, loss, "dB"))
    for full, sparse in (
        ("counts_p20", "counts_p20@16x16"),
        ("counts_p5", "counts_p5@16x16"),
        ("counts_p5", "counts_p5@blue:256"),
    ):
        loss = difference(nano(full), nano(sparse))
        found.append(Target("points", f"PSNR lost from {full} to {sparse}", 1.5, False, loss, "dB"))
    for condition in FULL:
        mad = nano(condition, "depth_mad_m")
        found.append(Target("depth", f"depth MAD, {condition}", 12, False, mad and 1e3 * mad, "mm", 1))
    return found


def against(rows: Sequence[Row], own: str, rival: str) -> list[Target]:
    """NANO with the weights `own` against a rival in the four metrics, at the condition that speaks least for NANO:
    differences paired over scenes, and met only with two of their errors to spare."""
    found, scenes = [], unique(row["scene"] for row in rows)
    for figure in FOUR:
        column = FIGURES[figure]
        sign = 1 if column.higher_is_better else -1
        gains = [
            paired.difference(*(paired.of_scenes(rows, scenes, method, condition, figure) for method in (own, rival)))
            for condition in RIVALS_AT
        ]
        worst = min(gains, key=lambda gain: sign * gain.mean - paired.TOLD * gain.error)
        what = f"{column.title}: {own} less {rival}, worst of {len(RIVALS_AT)} conditions"
        reached, error = column.factor * worst.mean, column.factor * worst.error
        found.append(Target("rivals", what, 0, column.higher_is_better, reached, "", column.digits, error))
    return found


def remarks(path: Path) -> dict[str, str]:
    """What was tried for the targets of each group and what to try next: `## group` and text, written by hand."""
    if not path.exists():
        return {}
    sections = path.read_text(encoding="utf-8").split("\n## ")[1:]
    return {head.strip(): body.strip() for head, _, body in (section.partition("\n") for section in sections)}


def section(targets: Sequence[Target], written: dict[str, str]) -> str:
    """The table, and for each group with a target missed what was tried and comes next."""
    parts = [table(["target", "wanted", "reached", "gap", ""], [target.line() for target in targets])]
    missed = dict.fromkeys(target.group for target in targets if target.met is False)
    done = sum(target.met is True for target in targets)
    parts.append(f"{done} of {len(targets)} met.{COMPARED if any(target.error for target in targets) else ''}\n")
    for group in missed:
        parts.append(f"**{group}**: {written.get(group, 'missed; nothing was tried yet.')}\n")
    return "\n".join(parts)

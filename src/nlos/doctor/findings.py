"""One line of the examination: PASS, WARN, FAIL or SKIP, what was looked at, what was found, what to do next."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Chart:
    """A measured curve for the report: `y` over `x`, and where it should stay."""

    title: str
    x_label: str
    y_label: str
    x: list[float]
    y: list[float]
    limits: list[float] = field(default_factory=list)
    """Horizontal lines."""
    marks: list[float] = field(default_factory=list)
    """Vertical lines."""


@dataclass(frozen=True)
class Finding:
    """One line of the examination."""

    verdict: str
    what: str
    said: str
    remedy: str = ""
    chart: Chart | None = None


def passed(what: str, said: str, chart: Chart | None = None) -> Finding:
    return Finding("PASS", what, said, "", chart)


def warned(what: str, said: str, remedy: str, chart: Chart | None = None) -> Finding:
    return Finding("WARN", what, said, remedy, chart)


def failed(what: str, said: str, remedy: str, chart: Chart | None = None) -> Finding:
    return Finding("FAIL", what, said, remedy, chart)


def skipped(what: str, why: str) -> Finding:
    """What the bench lacks, or nobody agreed to."""
    return Finding("SKIP", what, why)

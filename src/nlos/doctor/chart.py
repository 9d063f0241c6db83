"""A measured curve as a drawing within a page: lines in the page's own colours, in light and in dark."""

import math
from html import escape

from nlos.doctor.findings import Chart

_WIDTH, _HEIGHT = 640, 220
_LEFT, _RIGHT, _TOP, _BOTTOM = 64, 12, 12, 40


def drawn(chart: Chart) -> str:
    """The chart as SVG; points that are not numbers are left open."""
    xs = [x for x, y in zip(chart.x, chart.y, strict=True) if math.isfinite(y)]
    ys = [y for y in chart.y if math.isfinite(y)]
    if len(xs) < 2:
        return ""
    x_low, x_high = min(xs), max(max(xs), *(chart.marks or [max(xs)]))
    y_low, y_high = min([*ys, *chart.limits]), max([*ys, *chart.limits])
    pad = 0.06 * (y_high - y_low or abs(y_high) or 1.0)
    y_low, y_high = y_low - (pad if y_low < 0 or min(ys) > 0.5 * max(ys) else 0.0), y_high + pad

    def at_x(x: float) -> float:
        return _LEFT + (x - x_low) / (x_high - x_low) * (_WIDTH - _LEFT - _RIGHT)

    def at_y(y: float) -> float:
        return _HEIGHT - _BOTTOM - (y - y_low) / (y_high - y_low) * (_HEIGHT - _TOP - _BOTTOM)

    parts = []
    for x in _ticks(x_low, x_high):
        parts.append(f'<text x="{at_x(x):.1f}" y="{_HEIGHT - _BOTTOM + 16}" text-anchor="middle">{x:g}</text>')
        parts.append(_line(at_x(x), _TOP, at_x(x), _HEIGHT - _BOTTOM, "grid"))
    for y in _ticks(y_low, y_high):
        parts.append(f'<text x="{_LEFT - 6}" y="{at_y(y) + 4:.1f}" text-anchor="end">{y:g}</text>')
        parts.append(_line(_LEFT, at_y(y), _WIDTH - _RIGHT, at_y(y), "grid"))
    parts += [_line(_LEFT, at_y(y), _WIDTH - _RIGHT, at_y(y), "limit") for y in chart.limits]
    parts += [_line(at_x(x), _TOP, at_x(x), _HEIGHT - _BOTTOM, "limit") for x in chart.marks]
    points = " ".join(f"{at_x(x):.1f},{at_y(y):.1f}" for x, y in zip(chart.x, chart.y, strict=True) if math.isfinite(y))
    parts.append(f'<polyline class="curve" points="{points}"/>')
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    parts.append(f'<text x="{middle}" y="{_HEIGHT - 6}" text-anchor="middle">{escape(chart.x_label)}</text>')
    y_middle = (_TOP + _HEIGHT - _BOTTOM) / 2
    parts.append(
        f'<text transform="translate(13 {y_middle}) rotate(-90)" text-anchor="middle">{escape(chart.y_label)}</text>'
    )
    told = (
        f"{chart.title}: {chart.y_label} from {min(ys):.4g} to {max(ys):.4g}, {chart.x_label} from {min(chart.x):g} to "
        f"{max(chart.x):g}"
    )
    return (
        f'<figure><figcaption>{escape(chart.title)}</figcaption><svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" '
        f'aria-label="{escape(told)}">{"".join(parts)}</svg></figure>'
    )


def _line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def _ticks(low: float, high: float) -> list[float]:
    """Four to ten round numbers."""
    step = 10 ** math.floor(math.log10((high - low) / 4))
    step *= next(factor for factor in (5, 2, 1) if (high - low) / (step * factor) >= 3.5 or factor == 1)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]

"""Where the rows and columns of a grid lie: how large the wall is, and whether the array stands on its head."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

Array = npt.NDArray[Any]
_UNEVEN = 0.05
"""Steps may differ by this share."""
_ALIKE = 0.005


@dataclass(frozen=True)
class EvenGrid:
    """What positions and a wall's size say together."""

    sides_m: tuple[float, float] | None
    """None where neither says it."""
    flip_rows: bool
    flip_cols: bool
    notes: tuple[str, ...]

    def upright(self, array: Array) -> Array:
        """An array (H, W, ...) of the file with row 0 at the top and column 0 at the left."""
        rows, cols = (slice(None, None, -1 if flip else 1) for flip in (self.flip_rows, self.flip_cols))
        return array[rows, cols]


def on_even_grid(
    name: str,
    shape: tuple[int, ...],
    sides_m: tuple[float, float] | None,
    x_m: Array | None,
    y_m: Array | None,
    *,
    told: bool,
) -> EvenGrid:
    """The grid of `shape` (H, W) whose columns lie at `x_m` and rows at `y_m`, as far as these are stored, on a wall of
    `sides_m`. `told`: the size is the user's, and goes before the positions. Raises `InvalidData` for positions that
    are no even grid, and where they and the size contradict each other."""
    rows, cols = shape
    across, down = _line(name, "x_m", x_m, cols, shape, 1), _line(name, "y_m", y_m, rows, shape, 0)
    spans = [_span(name, "x_m", across, "columns"), _span(name, "y_m", down, "rows")]
    notes, found = [], []
    for side, (key, span, points) in enumerate((("x_m", spans[0], cols), ("y_m", spans[1], rows))):
        stated = None if sides_m is None else sides_m[side]
        if span is None or told:
            found.append(stated)
            continue
        whole = abs(span) * points / (points - 1)
        if stated is None or abs(stated / whole - 1) < _ALIKE:
            found.append(whole if stated is None else stated)
        elif abs(stated / abs(span) - 1) < _ALIKE:
            notes.append(
                f"wall_size_m {stated:g} m is from the first to the last of {key}; a wall of {points} points is one "
                f"step wider: {whole:.4g} m"
            )
            found.append(whole)
        else:
            raise InvalidData(
                f"{name}: wall_size_m says {stated:g} m, {key} a wall of {whole:.4g} m ({points} points, "
                f"{whole / points:.4g} m apart). Are both in metres? Correct one, or give --wall-size-m W or WxH."
            )
    for key, line in (("x_m", across), ("y_m", down)):
        middle = 0.0 if line is None else (line[0] + line[-1]) / 2
        if line is not None and abs(middle) > 0.01 * max(float(np.ptp(line)), 1e-9):
            notes.append(f"{key} is {middle:g} m in the middle of the grid; from here on it counts from there")
    flip_cols, flip_rows = spans[0] is not None and spans[0] < 0, spans[1] is not None and spans[1] > 0
    if flip_cols:
        notes.append("x_m falls from column to column: columns are turned round, so that column 0 is the left")
    if flip_rows:
        notes.append("y_m rises from row to row: rows are turned round, so that row 0 is the top")
    width_m, height_m = found
    both = None if width_m is None or height_m is None else (width_m, height_m)
    return EvenGrid(both, flip_rows, flip_cols, tuple(notes))


def refuse_turned_grid(place: str, shape: tuple[int, ...], sides_m: tuple[float, float]) -> None:
    """Raises `InvalidData` where points are evenly spaced in x and y only if rows and columns changed places."""
    (rows, cols), (width_m, height_m) = shape, sides_m
    as_is, turned = (width_m / cols) / (height_m / rows), (width_m / rows) / (height_m / cols)
    if abs(np.log(as_is)) > np.log(1.5) and abs(np.log(turned)) < np.log(1.02):
        raise InvalidData(
            f"{place}: {rows} rows and {cols} columns on a wall {width_m:g} m wide and "
            f"{height_m:g} m high: is x the first axis? Store it as [H, W, T] if so; `nlos reconstruct` and `nlos "
            "import` also take --axes XYT, and --axes YXT if it is [H, W, T] as it is."
        )


def _line(
    name: str, key: str, values: Array | None, count: int, shape: tuple[int, ...], axis: int
) -> npt.NDArray[np.float64] | None:
    """Positions of columns or rows (count,), also where each point has its own, as NumPy's meshgrid makes them."""
    if values is None:
        return None
    places = values.astype(np.float64) if values.dtype.kind in "uif" else np.full(values.shape, np.nan)
    if not np.isfinite(places).all():
        raise InvalidData(f"{name}: {key}: holds values that are no finite numbers of metres")
    if places.shape == shape:
        line = places.mean(axis=1 - axis)
        if np.abs(places - np.expand_dims(line, 1 - axis)).max() > _UNEVEN * max(float(np.ptp(line)), 1e-9) / count:
            raise InvalidData(
                f"{name}: {key}: is not the same along each {'column' if key == 'x_m' else 'row'}. Store the points as "
                "free positions: histograms [N, T], x_m [N], y_m [N]"
            )
        return np.asarray(line)
    if places.size != count:
        what = "columns" if key == "x_m" else "rows"
        raise InvalidData(f"{name}: {key}: holds {places.size} positions for {count} {what}")
    return places.ravel()


def _span(name: str, key: str, line: npt.NDArray[np.float64] | None, what: str) -> float | None:
    """From the first to the last, with its sign; None where there is one position or none."""
    if line is None or line.size < 2:
        return None
    span = float(line[-1] - line[0])
    steps = np.diff(line)
    if not span or np.abs(steps - span / len(steps)).max() > _UNEVEN * abs(span) / len(steps):
        raise InvalidData(
            f"{name}: {key}: its {what} are not evenly spaced in order. Store the points as free positions: histograms "
            "[N, T], x_m [N], y_m [N]"
        )
    return span

"""Pile-up where nobody knows the dead time: of a laser pulse the first photon clicks, and the rest of the record is
blind. It holds for every dead time that outlasts the record and is over before the next pulse, whatever it is."""

from dataclasses import dataclass
from enum import Enum
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from nlos.acquisition.digits import plus_minus
from nlos.acquisition.planning.preflight import PILE_UP
from nlos.calibration.constants import Quantity
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.told import warn

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_POINTS = 64
"""So many at a time: what is kept of each is a dozen histograms."""
_LEAD_S = 1e-9
"""Before its brightest bin a point's record holds none of that pulse."""
_BLOCKS = 8
"""Of what follows the pulse: late light must not hide that another part is as dark as before."""
_SURE = 3.0
"""Standard errors by which clicks are fewer than before the pulse, or more than a blind detector would give."""


class Blindness(Enum):
    """What the clicks of a scan say of a record after its first click."""

    NOT_DOUBTED = "few enough pulses click"
    POSSIBLE = "nothing speaks against one click a pulse"
    SEEN = "fewer clicks of even light after the pulse than before it, to the record's end"
    ENDS = "fewer clicks of even light after the pulse than before it, and later as many"
    OVER_BEFORE = "as many clicks of even light come after the pulse as before it"
    MORE_THAN_PULSES = "more clicks than pulses"


@dataclass(frozen=True)
class FirstClick:
    """What a scan itself says of pile-up."""

    blindness: Blindness
    dead_time: Quantity | None = None
    """Where it ends within the record."""

    @property
    def one_a_pulse(self) -> bool:
        """Whether pile-up may be undone as of one click in each pulse's record."""
        return self.blindness in (Blindness.POSSIBLE, Blindness.SEEN)


_FOUND: WeakKeyDictionary[RawPoints, FirstClick] = WeakKeyDictionary()
"""Of scans that are still held: measuring, correcting and drawing one ask the same."""


def first_click(raw: RawPoints) -> FirstClick:
    """Whether more than 5 % of some point's pulses click, and then whether one click a pulse explains them: even light
    (ambient, dark counts) is as bright after a pulse as before it, and clicks less while the detector is blind."""
    if raw not in _FOUND:
        _FOUND[raw] = _looked_for(raw)
    return _FOUND[raw]


def _looked_for(raw: RawPoints) -> FirstClick:
    """`first_click` of a scan that was not asked yet."""
    share = clicks_per_pulse(raw)
    if not share.max(initial=0) > PILE_UP:
        return FirstClick(Blindness.NOT_DOUBTED)
    if share.max() > 1:
        return FirstClick(Blindness.MORE_THAN_PULSES)
    places = np.flatnonzero(share > PILE_UP)
    lead = max(2, round(_LEAD_S / raw.time.bin_width_s))
    long = (
        raw.time.bins - max(int(raw.counts[some].argmax(axis=1).max()) for some in _some_at_a_time(places)) - lead
    ) // _BLOCKS
    if long < 1:
        return FirstClick(Blindness.POSSIBLE)
    before, opened, (seen, live, blind) = 0.0, 0.0, np.zeros((3, _BLOCKS))
    for some in _some_at_a_time(places):
        clicks, pulses = raw.counts[some].astype(np.float64), raw.sync_count[some][:, None]
        top = clicks.argmax(axis=1)[:, None]
        running = np.pad(np.cumsum(clicks, axis=1), ((0, 0), (1, 0)))
        end = np.maximum(top - lead, 0)
        before += float(np.take_along_axis(running, end, axis=1).sum())
        opened += float((end * pulses).sum())
        edges = top + lead + np.arange(_BLOCKS + 1) * long
        free = np.pad(np.cumsum(pulses - running[:, :-1], axis=1), ((0, 0), (1, 0)))
        for total, of in ((seen, running), (blind, free)):
            total += np.diff(np.take_along_axis(of, edges, axis=1)).sum(axis=0)
        live += long * pulses.sum()
    if not before > 0:
        return FirstClick(Blindness.POSSIBLE)
    even, least = before / opened * live, before / opened * blind
    error = np.sqrt(even + before * (live / opened) ** 2)
    fewer = even - seen > _SURE * error
    again = (np.abs(seen - even) < _SURE * error) & (seen - least > _SURE * error)
    first = int(np.flatnonzero(fewer)[-1]) if fewer.any() else -1  # blind until then, whatever shines before
    again[: first + 1] = False
    if not again.any():
        return FirstClick(Blindness.SEEN if fewer[-1] else Blindness.POSSIBLE)
    if first < 0:
        return FirstClick(Blindness.OVER_BEFORE)
    last = int(np.argmax(again))
    between = slice(first, last)
    part, chance = ((even - seen) / (even - least))[between], (error / (even - least))[between]
    width_s = long * raw.time.bin_width_s
    dark_s = float(np.clip(part.sum(), 0, last - first)) * width_s
    wide_s = float(np.hypot(np.linalg.norm(chance), (last - first - 1) / np.sqrt(12))) * width_s
    return FirstClick(Blindness.ENDS, Quantity(lead * raw.time.bin_width_s + first * width_s + dark_s, wide_s))


def doubt_pile_up(raw: RawPoints) -> None:
    """Says what clicks so often that the first photons of a pulse hide later ones, by a dead time nobody knows, and
    what is made of it."""
    found, period_s = first_click(raw), raw.period_s
    if found.blindness is Blindness.NOT_DOUBTED or period_s is None:
        return
    share, record_s = clicks_per_pulse(raw), raw.time.bins * raw.time.bin_width_s
    point = int(np.argmax(share))
    if found.one_a_pulse:
        made = (
            f"It is undone as of one click in the {record_s * 1e9:.3g} ns of a record and none missed for an earlier "
            f"pulse's, {period_s * 1e9:.3g} ns before"
        )
        if found.blindness is Blindness.SEEN:
            made += f" (seen: {found.blindness.value})"
        elif share[point] < 1:
            made += (
                f"; of a shorter dead time, late light comes out up to {1 / (1 - share[point]):.2g} times too bright"
            )
    elif found.dead_time is not None:
        time_ns, error_ns = found.dead_time.value * 1e9, found.dead_time.error * 1e9
        made = f"It is undone as of {plus_minus(time_ns, error_ns)} ns ({found.blindness.value})"
    else:
        made = f"It is not undone ({found.blindness.value}), and direct light seems to come early"
    warn(
        "%s clicked for %.0f %% of its laser pulses: early light hides later light, and the detector's dead time is "
        "not known. %s. Calibrate with --dead-time-ns, or attenuate the light.",
        raw.name(point), 100 * share[point], made,
    )  # fmt: skip


def clicks_per_pulse(raw: RawPoints) -> Floats:
    """In the record of each point, (N,); 0 where pulses are not known."""
    return np.asarray(raw.counts.sum(axis=1, dtype=np.float64) / np.where(raw.sync_count > 0, raw.sync_count, np.inf))


def correct_first_click(counts: npt.ArrayLike, sync_count: npt.ArrayLike) -> tuple[Counts, Counts]:
    """Photons that a detector without dead time would have counted, and their variance, both (N, T), where each of
    `sync_count` (N,) pulses has clicked at most once in the record (Coates, J. Phys. E 1, 878, 1968, eq. 4): bins can
    click in those pulses alone that have not clicked before. Counts of points without pulses stay; the variance is
    infinite where no pulse is left."""
    recorded = np.asarray(counts)
    photons, variance = recorded.astype(np.float32), recorded.astype(np.float32)
    known = np.broadcast_to(np.asarray(sync_count, dtype=np.float64), len(photons))
    for some in _some_at_a_time(np.flatnonzero(known > 0)):
        clicks, pulses = recorded[some].astype(np.float64), known[some, None]
        live = pulses - np.cumsum(clicks, axis=1) + clicks
        told = clicks < live
        of = np.where(told, live, 1.0)
        part = np.where(told, clicks, 0.0) / of
        photons[some] = -pulses * np.log1p(-part)
        variance[some] = np.where(told, pulses**2 * part / (of * (1 - part)), np.inf)
    return photons, variance


def _some_at_a_time(places: npt.NDArray[np.intp]) -> list[npt.NDArray[np.intp]]:
    return [places[first : first + _POINTS] for first in range(0, len(places), _POINTS)]

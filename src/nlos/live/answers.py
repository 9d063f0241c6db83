"""What the page is told about one scan: always of what the follower has read, never of the file behind its back."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from nlos.acquisition.recording.ended_as_asked import word_of
from nlos.acquisition.scanning.gathering import Gathering
from nlos.cli.escaped import escaped
from nlos.live.describe import described, packed, solid
from nlos.live.file_seen import Seen
from nlos.live.frames import Frames
from nlos.live.laser import Light, is_simulated, light_said
from nlos.live.scan import LiveScan

if TYPE_CHECKING:
    from nlos.acquisition.scanning.free_points import FreePoints
    from nlos.recon.live import LivePicture

ALARMS = {"alarm", "trip"}
"""Kinds of events that are counted in the page's head."""
EVENTS = 200
UNREAD_S = 6.0
"""The file of a scan under way is looked at several times a second: what was seen longer ago is not taken for now."""


class ScanAnswers:
    """Answers the page's questions about one `LiveScan`; may be asked from several threads."""

    def __init__(self, scan: LiveScan, taken_up: int = 0) -> None:
        self._scan, self._frames = scan, Frames(scan)
        self.taken_up = taken_up
        """How often it was followed anew: what a page knows of before is of another file, or of less of this one."""
        self._described: dict[str, tuple[LivePicture, dict[str, Any]]] = {}

    def stop(self, wait_s: float) -> None:
        """Makes no more frames."""
        self._frames.stop(wait_s)

    @property
    def made(self) -> int:
        """Pictures so far."""
        return self._scan.pictures

    @property
    def is_film_under_way(self) -> bool:
        """Whether a picture of a film may come any moment."""
        held = self._scan.gathered
        return held is not None and held.film is not None and not (self._scan.over or self._scan.broke_off)

    def state(self) -> dict[str, Any]:
        """Where the scan stands: samples, rates, time left, what happens next, events."""
        scan, seen = self._scan, self._scan.seen
        self._frames.start()
        answer: dict[str, Any] = {
            "run": escaped(scan.run.name), "methods": [live.method for live in scan.lives], "samples": 0, "planned": 0,
            "made": scan.pictures, "skipped": scan.skipped, "message": scan.message, "over": scan.over, "events": [],
            "alarms": 0, "taken_up": self.taken_up, "status": "missing" if scan.failed else "waiting",
            "lost": scan.error is not None or scan.broke_off,
            "frames": self._frames.samples, "frames_version": self._frames.version,
            "pictures": {
                method: {"samples": p.samples, "change": p.change, "error": p.error,
                         "explained": p.reconstruction.explained is not None}
                for method, p in scan.latest.items()
            },
        }  # fmt: skip
        if (coming := scan.coming) is not None:
            answer["coming"] = {
                "method": coming.method, "samples": coming.samples, "making": coming.making, "in_s": coming.in_s,
            }  # fmt: skip
        held = scan.gathered
        if seen is None or held is None:
            return answer
        with held.lock:
            done, elapsed_s, left_s = len(held.samples), held.elapsed_s, held.left_s
            detections, live_s = (sum(each) for each in zip(*held.recent, strict=True)) if held.recent else (0, 0.0)
        plan, status = seen.plan, _status(scan, seen)
        light = light_said(seen.header, seen.events, status in ("running", "paused"))
        if status == "unread" and light is Light.OFF:  # it may have been opened since
            light = Light.MAYBE
        if held.film is not None:
            answer["film"] = {
                "frame": held.film.shown_frame + 1, "frames": None if plan.until_stopped else plan.frames,
                "pictures": scan.pictures,
                "dropped": held.film.dropped, "objects": held.film.trails.told,
            }  # fmt: skip
        return answer | {
            "unread_s": seen.age_s if status == "unread" else None,
            "samples": done, "planned": plan.most_samples, "until_stopped": plan.until_stopped, "status": status,
            "light": light.value,
            "simulated": light not in (Light.REPLAYED, Light.UNTOLD) and is_simulated(seen.header),
            "started_utc": seen.started_utc, "elapsed_s": elapsed_s,
            "notes": {name: escaped(text) for name, text in seen.notes.items()},
            "left_s": None if plan.until_stopped else left_s,
            "rate_hz": detections / live_s if live_s else None,
            "events": [[round(e.bench_s, 3), e.kind, escaped(e.text)] for e in seen.events[-EVENTS:]],
            "events_before": max(0, len(seen.events) - EVENTS),
            "alarms": sum(e.kind in ALARMS for e in seen.events),
        }  # fmt: skip

    def plan(self) -> dict[str, Any]:
        """Where points lie, in which order they are visited (of a film until that repeats), and the time axis; `places`
        is 0 before that is known."""
        seen, held = self._scan.seen, self._scan.gathered
        if seen is None or held is None:
            return {"places": 0}
        plan, axis, wall = seen.plan, seen.plan.axis, seen.plan.wall
        # Every other frame runs backwards.
        points = np.arange(len(plan) if plan.frames == 1 else np.count_nonzero(plan.pass_ < math.lcm(plan.cycle, 2)))
        order = held.samples.place_of(points)
        count = len(held.samples.place_rates_hz())
        x_m, y_m = np.zeros(count), np.zeros(count)
        if plan.positions.on_grid:
            x_m, y_m = (grid.reshape(-1) for grid in np.meshgrid(wall.x_m(), wall.y_m()))
        else:
            x_m[order], y_m[order] = plan.positions.x_m[points], plan.positions.y_m[points]
        return {
            "places": count, "x_m": packed(x_m), "y_m": packed(y_m), "order": packed(order),
            "wall": [wall.width_m, wall.height_m], "grid": [wall.rows, wall.cols] if plan.positions.on_grid else None,
            "bins": axis.bins, "bin_ns": axis.bin_width_s * 1e9, "start_ns": axis.offset_s * 1e9,
            "window": [plan.stop.first_bin, plan.stop.end_bin] if plan.stop else None,
        }  # fmt: skip

    def rates(self, frame: int | None) -> dict[str, Any]:
        """Count rate at every place, NaN where not measured; of a frame of a finished scan as it was then."""
        if frame is not None:
            return self._frames.rates[self._step(frame)] or {"samples": 0}
        held = self._scan.gathered
        if held is None:
            return {"samples": 0}
        with held.lock:
            return {"samples": len(held.samples), "rates_hz": packed(held.samples.place_rates_hz())}

    def picture(self, method: str, frame: int | None) -> dict[str, Any]:
        """The newest picture by `method`, or a frame of a finished scan; empty where there is none yet."""
        if frame is not None:
            return self._frames.pictures[self._step(frame)] or {}
        newest = self._scan.latest.get(method)
        if newest is None:
            return {}
        known = self._described.get(method)
        if known is None or known[0] is not newest:
            known = self._described[method] = (newest, described(newest))
        return known[1]

    def histogram(self, place: int) -> dict[str, Any]:
        """Counts at a place so far, when its direct light arrives and how long that hides the scene: None where nobody
        knows yet. Raises `IndexError` where there is no such place."""
        held, zero = self._scan.gathered, self._scan.zero
        if held is None:
            raise IndexError("no sample yet")
        with held.lock:
            samples, counts = len(held.samples), held.samples.place_counts(place)
        arrival_s = None if zero is None else zero.at(*_where_m(held.samples, place))
        return {
            "samples": samples, "counts": packed(counts),
            "zero_ns": None if arrival_s is None else arrival_s * 1e9,
            "masked_ns": None if zero is None else zero.masked_s * 1e9,
        }  # fmt: skip

    def solid(self, method: str, frame: int | None) -> dict[str, Any]:
        """Surface and volume of the picture that `picture` describes; empty where there is none yet."""
        if frame is not None:
            return self._frames.solids[self._step(frame)] or {}
        newest = self._scan.latest.get(method)
        return {} if newest is None else solid(newest)

    def _step(self, number: int) -> int:
        if not 0 <= number < len(self._frames.samples):
            raise IndexError(f"frame {number} of {len(self._frames.samples)}")
        return number


def _where_m(samples: "Gathering | FreePoints", place: int) -> tuple[float, float]:
    """x and y of a place."""
    if not isinstance(samples, Gathering):
        return float(samples.x_m[place]), float(samples.y_m[place])
    wall = samples.plan.wall
    row, col = divmod(place, wall.cols)
    return float(wall.x_m()[col]), float(wall.y_m()[row])


def _status(scan: LiveScan, seen: Seen) -> str:
    """The file's status as `nlos` calls it, or `paused`, `lost` or `unread`, which it does not know."""
    if seen.status.name == "INTERRUPTED" and seen.plan.until_stopped and scan.gathered is not None:
        # That is how it ends, unless all of the wall has not come once.
        return "complete" if len(scan.gathered.samples) >= seen.plan.first_round else "interrupted"
    if seen.status.name != "RUNNING":
        return word_of(seen.status, ((event.kind, event.text) for event in seen.events))
    if scan.error is not None:
        return "lost"
    if not scan.read and seen.age_s > UNREAD_S:
        return "unread"
    said = [event.text for event in seen.events if event.kind == "scan"]
    return "paused" if said and said[-1].startswith("paused") else "running"

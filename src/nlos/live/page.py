"""The read-only page of a scan: JSON for one HTML file, to whoever has the token in the address, on this machine.

GET only; nothing here can reach the laser, the mirrors or the recording. Requests with another Host are refused, so
that no foreign page can ask through a browser's back (DNS rebinding); the token is compared in constant time.
"""

import json
import secrets
import threading
import time
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.live.scan import LiveScan

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.types import ASGIApp, Receive, Scope, Send

    from nlos.acquisition.scanning.gathering import Gathering

MOST_POINTS = 8000
KEPT_PICTURES = 24
ALARMS = {"alarm", "trip"}
"""Kinds of events that are counted in the page's head."""


class LivePage:
    """Answers the page's questions about one `LiveScan`."""

    def __init__(self, scan: LiveScan) -> None:
        self.scan = scan
        self.asked_s = time.monotonic()
        self._painting = threading.Lock()
        self._earlier: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._reading = threading.Lock()
        self._first: Gathering | None = None

    def state(self) -> dict[str, Any]:
        """Where the scan stands: counts, rates, time left, events."""
        from nlos.acquisition.errors import InvalidData
        from nlos.acquisition.recording.recording import Recording

        scan = self.scan
        answer: dict[str, Any] = {
            "run": scan.run.name, "method": scan.live.method, "samples": 0, "planned": 0, "pictures": scan.pictures,
            "skipped": scan.skipped, "message": scan.message, "over": scan.over, "events": [], "alarms": 0,
            "status": "waiting",
        }  # fmt: skip
        try:
            with Recording.open(scan.run) as recording:
                plan, records = recording.plan, recording.records
                newest = records[-64:]
                done, planned, events = len(records), len(plan), recording.events()
                answer |= {
                    "samples": done, "planned": planned, "status": recording.status.name.lower(),
                    "wall": [plan.wall.width_m, plan.wall.height_m, plan.wall.rows, plan.wall.cols],
                    "elapsed_s": recording.elapsed_s,
                    "left_s": recording.elapsed_s / done * (planned - done) if done else None,
                    "rate_hz": float(newest["total_count"].sum() / max(newest["live_time_s"].sum(), 1e-9)),
                    "events": [[round(e.bench_s, 2), e.kind, e.text] for e in events[-40:]],
                    "alarms": sum(e.kind in ALARMS for e in events),
                }  # fmt: skip
        except (FileNotFoundError, InvalidData) as error:
            answer["message"] = str(error)
        return answer

    def rates(self, samples: int | None = None) -> dict[str, Any]:
        """Count rate at every point of the wall, null where not measured; of a finished scan also as it was after its
        first `samples`."""
        gathering = self._gathered(samples)
        return {"rates_hz": None if gathering is None else rounded(gathering.rates_hz(), 0)}

    def histogram(self, row: int, col: int, samples: int | None = None) -> dict[str, Any]:
        """Counts at one point of the wall, of the first `samples` as in `rates`. Raises `IndexError` off the wall."""
        gathering = self._gathered(samples)
        if gathering is None:
            raise IndexError("no sample yet")
        axis = gathering.plan.axis
        counts = gathering.histogram(row, col)
        return {
            "counts": counts.astype(int).tolist(),
            "bin_ns": axis.bin_width_s * 1e9,
            "start_ns": axis.offset_s * 1e9,
        }

    def picture(self, samples: int | None) -> dict[str, Any]:
        """The newest picture; of a finished scan also that of its first `samples`, made when asked for."""
        newest = self.scan.picture
        if newest is None:
            return {}
        if samples is None or samples >= newest.samples or not self.scan.over:
            return described(newest)
        with self._painting:
            if samples not in self._earlier:
                self._earlier[samples] = self._of_first(samples)
                while len(self._earlier) > KEPT_PICTURES:
                    self._earlier.popitem(last=False)
            return self._earlier[samples]

    def _gathered(self, samples: int | None) -> "Gathering | None":
        """Everything so far; of a finished scan its first `samples`, kept until others are asked for."""
        everything = self.scan.gathering
        if everything is None or samples is None or samples >= len(everything) or not self.scan.over:
            return everything
        with self._reading:
            if self._first is None or len(self._first) != samples:
                self._first = self._read_first(samples)
            return self._first

    def _read_first(self, samples: int) -> "Gathering":
        from itertools import islice

        from nlos.acquisition.recording.recording import Recording
        from nlos.acquisition.scanning.gathering import Gathering

        with Recording.open(self.scan.run) as recording:
            gathering = Gathering(recording.plan)
            for sample in islice(recording.samples(), samples):
                gathering.add(sample)
        return gathering

    def _of_first(self, samples: int) -> dict[str, Any]:
        from nlos.calibration.errors import InvalidData
        from nlos.chain import calibrate_scan, constants_for
        from nlos.live.scan import loaded
        from nlos.recon.errors import ReconError
        from nlos.recon.live import LiveReconstruction

        gathering = self._gathered(samples)
        assert gathering is not None
        try:
            scan = loaded(self.scan.run, gathering)
            transient = calibrate_scan(scan, constants=constants_for(scan, self.scan.constants))
            alone = LiveReconstruction(self.scan.live.method, self.scan.live.settings)
            return described(alone.update(transient, len(gathering), scan.falloff))
        except (InvalidData, ReconError) as error:
            return {"samples": len(gathering), "message": str(error)}


def described(picture: Any) -> dict[str, Any]:
    """A picture as JSON: front view, depth, confidence, and its bright voxels as [x, y, z in mm, 0 to 255]."""
    from nlos.recon.pictures import visible_depth
    from nlos.recon.view3d import bright_voxels

    result = picture.reconstruction
    top = float(np.quantile(result.albedo, 0.999)) or 1.0
    points: list[list[int]] = []
    if result.volume is not None:
        where_m, value = bright_voxels(result.volume)
        keep = np.argsort(value)[-MOST_POINTS:]
        shade = np.clip(255 * value[keep] / max(float(value.max(initial=0.0)), 1e-30), 0, 255)
        points = np.concatenate([where_m[keep] * 1e3, shade[:, None]], axis=1).round().astype(int).tolist()
    return {
        "samples": picture.samples, "change": picture.change, "error": picture.error, "seconds": result.seconds,
        "albedo": rounded(result.albedo / top, 3), "depth_m": rounded(visible_depth(result), 3),
        "confidence": rounded(picture.confidence, 2), "points": points,
    }  # fmt: skip


def rounded(values: npt.NDArray[np.float32], digits: int) -> list[list[float | None]]:
    """Rows of numbers, null for NaN."""
    return [[round(float(value), digits) if np.isfinite(value) else None for value in row] for row in values]


def application(page: LivePage, token: str, hosts: set[str]) -> "ASGIApp":
    """The page under /`token`/, for requests that name one of `hosts`."""
    from starlette.applications import Starlette
    from starlette.responses import HTMLResponse, JSONResponse
    from starlette.routing import Route

    html = (Path(__file__).parent / "page.html").read_text(encoding="utf-8")

    def number(request: "Request", key: str) -> int | None:
        text = request.query_params.get(key, "")
        return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else None

    def index(request: "Request") -> "Response":
        nonce = secrets.token_urlsafe(16)
        policy = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
            "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        return HTMLResponse(html.replace("NONCE", nonce), headers={"Content-Security-Policy": policy})

    def histogram(request: "Request") -> "Response":
        row, col = number(request, "row"), number(request, "col")
        try:
            place = -1 if row is None else row, -1 if col is None else col
            return JSONResponse(page.histogram(*place, number(request, "samples")))
        except IndexError as error:
            return JSONResponse({"message": str(error)}, status_code=404)

    routes = [
        Route("/", index, methods=["GET"]),
        Route("/state", lambda request: JSONResponse(page.state()), methods=["GET"]),
        Route("/rates", lambda request: JSONResponse(page.rates(number(request, "samples"))), methods=["GET"]),
        Route("/picture", lambda request: JSONResponse(page.picture(number(request, "samples"))), methods=["GET"]),
        Route("/histogram", histogram, methods=["GET"]),
    ]
    return _Door(Starlette(routes=routes), page, token, hosts)


class _Door:
    """Lets in GET requests that name this host and begin with the token."""

    def __init__(self, inside: "Starlette", page: LivePage, token: str, hosts: set[str]) -> None:
        self._inside, self._page, self._token, self._hosts = inside, page, token.encode(), hosts

    async def __call__(self, scope: "Scope", receive: "Receive", send: "Send") -> None:
        if scope["type"] == "lifespan":
            await self._inside(scope, receive, send)
            return
        if scope["type"] != "http":
            return
        host = next((value for key, value in scope["headers"] if key == b"host"), b"").decode("latin-1")
        _, _, rest = scope["path"].partition("/")
        token, slash, path = rest.partition("/")
        allowed = secrets.compare_digest(token.encode("utf-8", "surrogatepass"), self._token)
        if scope["method"] != "GET" or host not in self._hosts or not allowed or not slash:
            body = json.dumps({"message": "refused"}).encode()
            status = 405 if scope["method"] != "GET" else 403
            await send(
                {"type": "http.response.start", "status": status, "headers": [(b"content-type", b"application/json")]}
            )
            await send({"type": "http.response.body", "body": body})
            return
        self._page.asked_s = time.monotonic()

        async def sealed(message: Any) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message["headers"], (b"cache-control", b"no-store"), (b"referrer-policy", b"no-referrer"),
                    (b"x-content-type-options", b"nosniff"),
                ]  # fmt: skip
            await send(message)

        inner = {**scope, "path": f"/{path}", "raw_path": f"/{path}".encode()}
        await self._inside(inner, receive, sealed)

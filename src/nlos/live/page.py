"""The read-only page of one scan or several: JSON for one HTML file, to whoever has the token in the address.

GET only; nothing here can reach the laser, the mirrors or the recording.
"""

import json
import time
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from nlos.live.admission import admitted, page_answer
from nlos.live.answers import ScanAnswers
from nlos.live.goal import LEVELS, STABLE, SURE
from nlos.live.scan import LiveScan
from nlos.live.web import Answer, Refused, Request
from nlos.recon.seen import DOUBTFUL, FAINT, FULL, SOLID

STYLES = ("colours.css", "page.css")
SCRIPTS = ("draw.js", "pictures.js", "turning.js", "histogram.js", "map.js", "slider.js", "page.js")
"""One page is made of these; each is short, and they share one scope in this order."""


class LivePage:
    """Answers whoever names one of `hosts` and begins the path with `token`."""

    def __init__(self, scans: Sequence[LiveScan], token: str, hosts: set[str]) -> None:
        self._scans = [ScanAnswers(scan) for scan in scans]
        self._token, self._hosts = token.encode(), hosts
        self._html = assembled()
        self.asked_s = time.monotonic()

    def stop(self, wait_s: float) -> None:
        """Ends what was begun to answer."""
        for scan in self._scans:
            scan.stop(wait_s)

    def begin_anew(self, number: int, scan: LiveScan, wait_s: float) -> None:
        """Shows `scan` in the place of the one of that number, of which nothing is made any more on return."""
        before = self._scans[number]
        self._scans[number] = ScanAnswers(scan, before.taken_up + 1)
        before.stop(wait_s)

    def __call__(self, request: Request) -> Answer:
        """Raises `Refused`."""
        what = admitted(request, self._token, self._hosts)
        self.asked_s = time.monotonic()
        if what == "":
            return page_answer(self._html)
        try:
            return Answer(json.dumps(self._asked(what, request)).encode())
        except (KeyError, IndexError) as error:
            return Answer(json.dumps({"message": str(error.args[0])}).encode(), 404)

    def nothing_new(self, request: Request) -> bool:
        """Whether whoever asks for the `state` has all pictures there are: `made` says how many of each scan. Only of
        films under way, where a picture in time is what it is about."""
        known = request.query.get("made")
        if known is None or not any(scan.is_film_under_way for scan in self._scans):
            return False
        try:
            what = admitted(request, self._token, self._hosts)
        except Refused:
            return False
        return what == "state" and known == ",".join(str(scan.made) for scan in self._scans)

    def _asked(self, what: str, request: Request) -> dict[str, Any]:
        query = request.query
        if what == "state":
            return {"scans": [scan.state() for scan in self._scans]}
        scan = self._scans[_number(query.get("scan", "0"), "scan")]
        frame = _number(query["frame"], "frame") if "frame" in query else None
        match what:
            case "plan":
                return scan.plan()
            case "rates":
                return scan.rates(frame)
            case "picture":
                return scan.picture(query.get("method", ""), frame)
            case "solid":
                return scan.solid(query.get("method", ""), frame)
            case "histogram":
                return scan.histogram(_number(query.get("place", ""), "place"))
        raise KeyError(f"nothing is called {what[:40]}")


def assembled() -> str:
    """The page with its styles and scripts inside."""
    folder = files("nlos.live") / "page_parts"
    read = {name: (folder / name).read_text(encoding="utf-8") for name in ("page.html", *STYLES, *SCRIPTS)}
    turning = (files("nlos.recon") / "view3d.js").read_text(encoding="utf-8")
    return (
        read["page.html"]
        .replace("STYLES", "\n".join(read[name] for name in STYLES))
        .replace("SCRIPTS", "\n".join([turning, *(read[name] for name in SCRIPTS)]))
        .replace("FAINT_AT", f"{FAINT:g}")
        .replace("FULL_AT", f"{FULL:g}")
        .replace("SOLID_AT", f"{SOLID:g}")
        .replace("DOUBTFUL_AT", f"{DOUBTFUL:g}")
        .replace("SURE_PERCENT", f"{100 * LEVELS[SURE]:g}")
        .replace("SETTLED_PERCENT", f"{100 * LEVELS[STABLE]:g}")
        .replace("SURE_AT", f"{LEVELS[SURE]:g}")
        .replace("STABLE_AT", f"{LEVELS[STABLE]:g}")
    )


def _number(text: str, name: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise KeyError(f"{name} is not a number")
    return int(text)

"""A finished scan along its time: pictures of its first twentieth, two twentieths ..., made once and kept."""

import threading
from typing import TYPE_CHECKING, Any

from nlos.acquisition.errors import InvalidData as RecordingInvalid
from nlos.acquisition.recording.recording import Recording
from nlos.calibration.errors import InvalidData
from nlos.live.describe import described, packed, solid
from nlos.live.so_far import scan_of, shown_of
from nlos.recon.errors import ReconError
from nlos.recon.live import LiveReconstruction

if TYPE_CHECKING:
    from nlos.live.scan import LiveScan

FRAMES = 20


class Frames:
    """Frame k of `FRAMES` is the scan after (k + 1) / `FRAMES` of its samples, by the quickest method, then by the
    best. One thread makes them all, whatever is asked for: nobody waits, and there are never more."""

    def __init__(self, scan: "LiveScan") -> None:
        self._scan = scan
        self._thread: threading.Thread | None = None
        self._starting = threading.Lock()
        self._stopped = threading.Event()
        self.pictures: list[dict[str, Any] | None] = [None] * FRAMES
        self.solids: list[dict[str, Any] | None] = [None] * FRAMES
        self.rates: list[dict[str, Any] | None] = [None] * FRAMES
        self.samples: list[int] = [0] * FRAMES
        """How many each is of; 0 where it is not there yet."""
        self.version = 0
        """Grows with every frame that is made or made better."""

    def start(self) -> None:
        """Begins once the scan is over; may be called again and again."""
        with self._starting:
            if self._thread is None and self._scan.over and self._scan.gathering is not None:
                self._thread = threading.Thread(target=self._make, daemon=True)
                self._thread.start()

    def stop(self, wait_s: float) -> None:
        """Ends after the picture that is being made: a process that ends while a thread reads HDF5 crashes."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(wait_s)

    def _make(self) -> None:
        best = self._scan.lives[-1]
        for live in self._scan.lives:
            self._make_by(LiveReconstruction(live.method, live.settings), live is best)

    def _make_by(self, live: "LiveReconstruction", best: bool) -> None:
        assert self._scan.gathering is not None
        assert self._scan.seen is not None
        total = len(self._scan.gathering)
        cuts = [max(1, round((k + 1) / FRAMES * total)) for k in range(FRAMES)]
        try:
            with Recording.open(self._scan.run) as recording:  # the follower has closed its own handle
                if recording.header.identity != self._scan.seen.which:
                    return
                gathering, frame = shown_of(recording.plan), 0
                for sample in recording.samples():
                    if self._stopped.is_set():
                        return
                    gathering.add(sample)
                    while frame < FRAMES and len(gathering) == cuts[frame] and not self._stopped.is_set():
                        self._keep_rates(frame, gathering)
                        try:
                            scan = scan_of(self._scan.empty, gathering)
                            transient = self._scan.calibrated(scan).transient
                            picture = live.update(transient, len(gathering), scan.falloff)
                            picture = live.explained(picture, transient, scan.falloff)
                            self.pictures[frame], self.solids[frame] = described(picture), solid(picture)
                        except (InvalidData, ReconError) as error:
                            if self.pictures[frame] is None:
                                self.pictures[frame] = {"samples": len(gathering), "message": str(error)}
                        self.samples[frame] = cuts[frame]
                        self.version += 1
                        frame += 1
        except (FileNotFoundError, RecordingInvalid) as error:
            self._scan.message = str(error)

    def _keep_rates(self, frame: int, gathering: Any) -> None:
        self.rates[frame] = {"samples": len(gathering), "rates_hz": packed(gathering.place_rates_hz())}

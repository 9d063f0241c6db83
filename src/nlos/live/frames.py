"""A finished scan along its time, as steps of a slider: pictures that are made once and kept."""

import threading
from typing import TYPE_CHECKING, Any

from nlos.acquisition.errors import InvalidData as RecordingInvalid
from nlos.acquisition.recording.recording import Recording
from nlos.live.describe import described, packed, solid
from nlos.live.steps import FRAMES, Step, film_frames, steps_of_film, steps_of_scan
from nlos.recon.errors import NO_PICTURE

if TYPE_CHECKING:
    from nlos.live.scan import LiveScan
    from nlos.recon.live import LiveReconstruction


class Frames:
    """What every step shows (`steps.py`), by the quickest method, then by the best. One thread makes them all, whatever
    is asked for: nobody waits, and there are never more."""

    def __init__(self, scan: "LiveScan") -> None:
        self._scan = scan
        self._thread: threading.Thread | None = None
        self._starting = threading.Lock()
        self._stopped = threading.Event()
        self._film: list[int] = []
        self._room(FRAMES)
        self.version = 0
        """Grows with every frame that is made or made better."""

    def _room(self, steps: int) -> None:
        self.pictures: list[dict[str, Any] | None] = [None] * steps
        self.solids: list[dict[str, Any] | None] = [None] * steps
        self.rates: list[dict[str, Any] | None] = [None] * steps
        self.samples: list[int] = [0] * steps
        """How many each is of; 0 where it is not there yet."""

    def start(self) -> None:
        """Begins once the scan is over; may be called again and again."""
        with self._starting:
            held = self._scan.gathered
            if self._thread is None and self._scan.over and held is not None:
                if held.film is not None:
                    self._film = film_frames(held.film.over + 1)
                    self._room(len(self._film))
                self._thread = threading.Thread(target=self._make, daemon=True)
                self._thread.start()

    def stop(self, wait_s: float) -> None:
        """Ends after the picture that is being made: a process that ends while a thread reads HDF5 crashes."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join(wait_s)

    def _make(self) -> None:
        for live in self._scan.lives:
            self._make_by(live.anew())

    def _make_by(self, live: "LiveReconstruction") -> None:
        held = self._scan.gathered
        assert held is not None
        try:
            with Recording.open(self._scan.run) as recording:  # the follower has closed its own handle
                if recording.header.identity != held.identity:
                    return
                samples = iter(recording.samples())
                made = steps_of_film(held, samples, self._film) if self._film else steps_of_scan(held, samples)
                for number, step in enumerate(made):
                    if self._stopped.is_set():
                        return
                    self._keep(number, step, live)
        except (FileNotFoundError, RecordingInvalid) as error:
            self._scan.message = str(error)

    def _keep(self, number: int, step: Step, live: "LiveReconstruction") -> None:
        self.rates[number] = {"samples": step.samples, "rates_hz": packed(step.rates_hz)}
        try:
            picture = step.picture(live)
            self.pictures[number], self.solids[number] = described(picture) | step.told(), solid(picture)
        except NO_PICTURE as error:
            if self.pictures[number] is None:
                self.pictures[number] = {"samples": step.samples, "message": str(error)}
        self.samples[number] = step.samples
        self.version += 1

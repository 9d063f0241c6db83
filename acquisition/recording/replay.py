"""A finished recording as a source of samples: at the pace at which it was taken, faster, or flat out."""

from collections.abc import Iterator

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.sample import Sample, is_pause
from nlos.drivers.clock import Clock, SystemClock


def replay(recording: Recording, speed: float | None = 1.0, clock: Clock | None = None) -> Iterator[Sample]:
    """The intact samples as a live scan yields them: each at the moment its dwell was over, `speed` times as fast,
    without the pauses; None does not wait at all. Raises `ValueError` for a speed that is not above 0."""
    if speed is None:
        return recording.samples()
    if not speed > 0:
        raise ValueError(f"replay speed is {speed:g}; it must be above 0")
    return _paced(recording, speed, clock or SystemClock())


def _paced(recording: Recording, speed: float, clock: Clock) -> Iterator[Sample]:
    started_s, last_s, passed_s = clock.now(), 0.0, 0.0
    for sample in recording.samples():
        over_s = sample.taken_s + sample.histogram.live_time_s
        if not is_pause(over_s - last_s, sample.histogram.live_time_s):
            passed_s += over_s - last_s
        last_s = over_s
        clock.sleep(started_s + passed_s / speed - clock.now())
        yield sample

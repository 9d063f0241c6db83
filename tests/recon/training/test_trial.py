"""What a training takes, tried beforehand: with batches that grow, and no further than memory goes."""

import json
from typing import Any

import pytest

from nlos.recon.training import trial as tried_here
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.trial import trial, tried


def settings(batch: int) -> TrainSettings:
    grid = {"rows": 16, "cols": 16, "bins": 64, "bin_width_ps": 256.0}
    said: dict[str, Any] = {
        "method": "unet", "data": grid, "validation": {"seed": 2, "scenes": 1, "held_out": True, **grid},
        "samples": 4096, "batch": batch, "warm_up_steps": 1,
    }  # fmt: skip
    return TrainSettings.model_validate_json(json.dumps(said))


@pytest.mark.parametrize(
    ("batch", "sizes"), [(1, [1, 1]), (3, [1, 3, 3]), (8, [1, 4, 8, 8]), (4096, [1, 4, 8, 16, 16])]
)
def test_batches_grow_to_the_one_wanted_and_not_beyond_what_is_tried(batch: int, sizes: list[int]) -> None:
    assert tried(batch) == sizes


def test_a_large_batch_is_not_made_to_say_what_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    batch_at = tried_here.batch_at

    def watched(data: Any, cache: Any, seed: int, step: int, size: int) -> Any:
        made.append(size)
        return batch_at(data, cache, seed, step, size)

    monkeypatch.setattr(tried_here, "batch_at", watched)
    monkeypatch.setattr(tried_here, "MOST_TRIED", 4)
    # what libraries take at first counts as a batch's where so few are tried: no machine's memory is to end this
    monkeypatch.setattr(tried_here, "available_bytes", lambda: 1 << 40)
    small, large = trial(settings(4)), trial(settings(4096))
    assert max(made) == 4
    assert large["peak_rss_mb"] >= small["peak_rss_mb"] - 50


def test_one_that_does_not_fit_is_refused_while_batches_are_small(monkeypatch: pytest.MonkeyPatch) -> None:
    peaks = iter([100.0, 400.0, 800.0])  # 100 MB a sample
    monkeypatch.setattr(tried_here, "peak_rss_mb", lambda: next(peaks))
    monkeypatch.setattr(tried_here, "available_bytes", lambda: 50 << 30)
    with pytest.raises(MemoryError, match=r"up to 4, one of 4096 takes about 399.6 GiB more, 50.0 GiB are free"):
        trial(settings(4096))

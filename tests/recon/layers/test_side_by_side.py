"""Parts of a network's work side by side: the same results in the same order, and nothing of it left behind."""

import threading
import time
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

from nlos.recon.layers.side_by_side import LARGEST, side_by_side
from nlos.recon.layers.symmetries import mean_over_symmetries
from nlos.recon.parts import counted, heard_by


@pytest.fixture(autouse=True)
def two_cores() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def met(barrier: threading.Barrier) -> int:
    """Returns only where two do this at the same time."""
    barrier.wait(timeout=20)
    return torch.get_num_threads()


def test_small_parts_are_done_at_the_same_time_by_a_core_each() -> None:
    barrier = threading.Barrier(2)
    with torch.inference_mode():
        threads = list(side_by_side([lambda: met(barrier)] * 4, torch.ones(8)))
    assert threads == [1, 1, 1, 1]
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("why", ["large", "learned", "nothing known", "one core"])
def test_else_they_are_done_one_after_the_other_as_they_are_asked_for(why: str) -> None:
    field = None if why == "nothing known" else torch.ones(1).expand(LARGEST + 1 if why == "large" else 8)
    torch.set_num_threads(1 if why == "one core" else 2)
    done: list[int] = []

    def part(number: int) -> int:
        done.append(number)
        return threading.get_ident()

    with torch.set_grad_enabled(why == "learned"):
        first = next(side_by_side([lambda k=k: part(k) for k in range(3)], field))  # type: ignore[misc]
    assert (first, done) == (threading.get_ident(), [0])


def test_the_mean_over_mirror_images_is_the_same_to_rounding() -> None:
    generator = torch.Generator().manual_seed(0)
    kernel, volume = torch.randn(1, 1, 3, 3, 3, generator=generator), torch.randn(1, 1, 6, 12, 12, generator=generator)

    def see(images: "list[Tensor | None]") -> tuple[Tensor, ...]:
        assert images[0] is not None
        seen = torch.conv3d(images[0], kernel, padding=1)
        return seen[:, 0].amax(dim=1), seen.square()

    made = {}
    with torch.inference_mode():
        for threads in (1, 2):
            torch.set_num_threads(threads)
            made[threads] = mean_over_symmetries(see, (volume, None), square=True)  # type: ignore[arg-type]
    for one, two in zip(made[1], made[2], strict=True):
        torch.testing.assert_close(two, one, rtol=1e-5, atol=1e-6)


def test_whoever_gives_up_waits_for_what_is_under_way_and_no_more() -> None:
    begun: list[int] = []

    def part(number: int) -> int:
        begun.append(number)
        time.sleep(0.05)
        return number

    def enough(done: int, total: int, name: str) -> None:
        raise InterruptedError

    threads = threading.active_count()
    parts = [lambda k=k: part(k) for k in range(40)]  # type: ignore[misc]
    with heard_by(None, within=enough), torch.inference_mode(), pytest.raises(InterruptedError):
        list(counted(side_by_side(parts, torch.ones(8)), len(parts), "parts"))
    assert len(begun) < 10
    assert threading.active_count() == threads
    assert torch.get_num_threads() == 2


def test_what_goes_wrong_in_one_is_raised() -> None:
    def wrong() -> int:
        raise ValueError("that one")

    with torch.inference_mode(), pytest.raises(ValueError, match="that one"):
        list(side_by_side([lambda: 1, wrong], torch.ones(8)))

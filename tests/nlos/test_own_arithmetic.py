"""What a program has set for its own arithmetic changes no picture, and is as it was afterwards."""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

import nlos
from nlos.recon.own_arithmetic import own_arithmetic


def _picture(method: str) -> nlos.Picture:
    rng = np.random.default_rng(0)
    counts = rng.poisson(0.2, (12, 12, 96)) + 20.0 * (np.arange(96) == 50)
    return nlos.reconstruct(counts, method=method, wall=1.0, bin_width=96e-12)


@cache
def _plain(method: str) -> nlos.Picture:
    return _picture(method)


@contextmanager
def _default_dtype(dtype: torch.dtype) -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        yield
        assert torch.get_default_dtype() is dtype
    finally:
        torch.set_default_dtype(before)


@contextmanager
def _default_device(name: str) -> Iterator[None]:
    torch.set_default_device(name)
    try:
        yield
        assert torch.get_default_device().type == name
    finally:
        torch.set_default_device(None)


@contextmanager
def _numpy_raises() -> Iterator[None]:
    with np.errstate(all="raise"):
        yield
        assert set(np.geterr().values()) == {"raise"}


@contextmanager
def _autocast() -> Iterator[None]:
    with torch.autocast("cpu", dtype=torch.bfloat16):
        yield
        assert torch.is_autocast_enabled("cpu")


SET: dict[str, Callable[[], AbstractContextManager[None]]] = {
    "float64": lambda: _default_dtype(torch.float64),
    "bfloat16": lambda: _default_dtype(torch.bfloat16),
    "no device": lambda: _default_device("meta"),
    "autocast": _autocast,
    "numpy raises": _numpy_raises,
}


@pytest.mark.parametrize("method", ["nano", "unet", "lct", "gram"])
@pytest.mark.parametrize("name", SET)
def test_a_picture_is_the_same_whatever_the_program_has_set(name: str, method: str) -> None:
    plain = _plain(method)
    with SET[name]():
        theirs = _picture(method)
    assert (theirs.albedo == plain.albedo).all()
    assert np.array_equal(theirs.depth_m, plain.depth_m, equal_nan=True)


@pytest.mark.parametrize("name", SET)
def test_a_network_that_was_built_within_serves_outside(name: str) -> None:
    from nlos.recon.with_torch import built

    built.cache_clear()
    with SET[name]():
        theirs = _picture("unet")
    assert (_picture("unet").albedo == theirs.albedo).all()


def test_what_is_kept_can_be_computed_with_outside_of_inference_mode() -> None:
    with torch.inference_mode():
        with own_arithmetic():
            kept = torch.ones(3)
        assert torch.is_inference_mode_enabled()
    assert not kept.is_inference()
    kept.requires_grad_()


def test_a_scan_is_calibrated_where_numpy_raises(tmp_path: Path) -> None:
    with nlos.open_bench("simulated") as bench:
        list(nlos.scan("five_by_five", bench, output=tmp_path / "run.h5"))
    plain = nlos.load(tmp_path / "run.h5").calibrated().counts
    with _numpy_raises():
        assert (nlos.load(tmp_path / "run.h5").calibrated().counts == plain).all()


def test_threads_that_come_and_go_leave_what_was_set() -> None:
    inside, leave = threading.Event(), threading.Event()

    def longer() -> None:
        with own_arithmetic():
            inside.set()
            leave.wait(60.0)
            assert torch.get_default_dtype() is torch.float32

    with _default_dtype(torch.float64):
        with own_arithmetic():
            other = threading.Thread(target=longer)
            other.start()
            inside.wait(60.0)
        assert torch.get_default_dtype() is torch.float32  # the other one is still within
        leave.set()
        other.join(60.0)

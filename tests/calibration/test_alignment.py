import numpy as np
import numpy.typing as npt
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from nlos.calibration.alignment import align, align_variance, recorded_bins

histograms = arrays(np.uint32, (3, 40), elements=st.integers(0, 5000))
offsets = arrays(np.float64, (3,), elements=st.floats(-60, 60))


@given(histograms, arrays(np.float64, (3,), elements=st.floats(0, 40)))
def test_a_shift_conserves_the_counts_behind_the_arrival(counts: npt.NDArray[np.uint32], at: npt.NDArray) -> None:
    shifted = align(counts, at, 41)
    for row, offset in enumerate(at):
        whole = int(offset)
        behind = counts[row, whole:].sum() - (offset - whole) * (counts[row, whole] if whole < 40 else 0)
        assert np.isclose(shifted[row].sum(), behind, rtol=1e-5, atol=1e-2)


@given(histograms, offsets)
def test_late_bins_never_come_round_to_the_front(counts: npt.NDArray[np.uint32], at: npt.NDArray) -> None:
    bins = np.arange(70)
    for row, (shifted, offset) in enumerate(zip(align(counts, at, 70), at, strict=True)):
        outside = (bins + offset <= -1) | (bins + offset >= 40)
        assert not shifted[outside].any(), row


@given(histograms, offsets)
def test_a_shift_by_whole_bins_changes_no_count(counts: npt.NDArray[np.uint32], at: npt.NDArray) -> None:
    shifted = align(counts, np.floor(at), 30)
    inside = recorded_bins(np.floor(at), 40, 30)
    for row, offset in enumerate(np.floor(at).astype(int)):
        where = np.flatnonzero(inside[row])
        assert (shifted[row, where] == counts[row, where + offset]).all()


@settings(max_examples=5)
@given(st.floats(0, 1))
def test_the_variance_is_that_of_shifted_poisson_counts(offset: float) -> None:
    mean = np.linspace(5, 50, 12)
    draws = np.random.default_rng(1).poisson(mean, (4000, 12))
    at = np.full(4000, offset)
    told = align_variance(mean[None], [offset], 11)[0]
    assert np.allclose(align(draws, at, 11).var(axis=0), told, rtol=0.15)

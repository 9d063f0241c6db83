"""Dark print on a bright board stays dark: fonts that no network learned from."""

from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.lettering import LETTER_FONTS
from studies.boards import FONTS, board, contrast


def test_print_keeps_most_of_its_contrast() -> None:
    """Thin upright print seen from diffuse light, and bold print on a slant that reflects light back."""
    assert not set(FONTS) & set(LETTER_FONTS)
    for index in (4, 7):
        seen = board(index)
        assert seen.print.sum() > 20 < seen.paper.sum()
        of_truth = contrast(seen.truth.intensity, seen)
        assert 0.7 < of_truth < 1
        picture = reconstruct(seen.scan, "nano", {"falloff": seen.falloff}).albedo
        assert contrast(picture, seen) > 0.6 * of_truth, index

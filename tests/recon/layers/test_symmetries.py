"""Mirror images of a wall: their inverse, and the mean over all of them."""

import pytest
import torch

from nlos.recon.layers.symmetries import Fields, mean_over_symmetries, mirrored, mirrored_back


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("flips", [(), (-2,), (-1,), (-2, -1)])
def test_mirrored_back_is_the_inverse(flips: tuple[int, ...], turned: bool) -> None:
    x = torch.rand(2, 3, 5, 7)
    torch.testing.assert_close(mirrored_back(mirrored(x, flips, turned), flips, turned), x, rtol=0, atol=0)


@pytest.mark.parametrize(("square", "images"), [(True, 8), (False, 4)])
def test_the_mean_is_over_every_image_once(square: bool, images: int) -> None:
    x, seen = torch.rand(1, 2, 6, 6), []

    def first_row(fields: Fields) -> tuple[torch.Tensor]:
        assert fields[0] is not None
        assert fields[1] is None
        seen.extend(fields[0])
        return (torch.cat((fields[0][..., :1, :], torch.zeros_like(fields[0][..., 1:, :])), dim=-2),)

    (mean,) = mean_over_symmetries(first_row, (x, None), square)
    assert len({tuple(image.flatten().tolist()) for image in seen}) == len(seen) == images
    # of the images a quarter (a half without turns) have a given side of the wall in their first row
    sides = torch.zeros(6, 6)
    for side in (sides[0], sides[-1], *((sides[:, 0], sides[:, -1]) if square else ())):
        side += 0.25 if square else 0.5
    torch.testing.assert_close(mean, x * sides)
    same = mean_over_symmetries(lambda fields: [fields[0]], (x, None), square)  # type: ignore[list-item]
    torch.testing.assert_close(same[0], x)

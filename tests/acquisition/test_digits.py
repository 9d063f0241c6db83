"""Measured numbers are printed with the digits that were measured."""

import pytest

from nlos.acquisition.digits import plus_minus, two_digits


@pytest.mark.parametrize(
    ("value", "error", "said"),
    [
        (2013.4, 45.0, "2010 +- 50"),
        (22201.0, 149.0, "22200 +- 150"),
        (0.827, 0.119, "0.83 +- 0.12"),  # the Particle Data Group's own example
        (0.827, 0.367, "0.8 +- 0.4"),
        (47.00332, 0.00518, "47.003 +- 0.005"),
        (9.996, 0.0962, "10.00 +- 0.10"),
        (-0.0004, 0.3, "0.00 +- 0.30"),
        (76.9e-9, 0.31e-9, "(76.90 +- 0.31)e-9"),
        (5.0, 0.0, "5 +- 0"),
    ],
)
def test_a_value_has_the_digits_of_its_error(value: float, error: float, said: str) -> None:
    assert plus_minus(value, error) == said


@pytest.mark.parametrize(
    ("value", "said"),
    [(2013.4, "2000"), (613.0, "610"), (22.7, "23"), (0.0, "0"), (0.123, "0.12"), (99700.0, "100000")],
)
def test_a_rate_that_was_looked_at_for_a_moment_has_two(value: float, said: str) -> None:
    assert two_digits(value) == said

"""Measured numbers with as many digits as were measured: 2010 +- 50, not 2013.4 +- 45.2."""

import math
from decimal import ROUND_HALF_UP, Decimal


def plus_minus(value: float, error: float) -> str:
    """A value and its standard error, rounded as the Particle Data Group does: the error to two digits where its
    three leading ones are below 355, else to one (Review of Particle Physics, section 5.3)."""
    if math.isfinite(value) and math.isfinite(error) and error > 0 and _decimals(error) > 6:
        exponent = 3 * math.floor(math.log10(max(abs(value), error)) / 3)
        scaled, scaled_error = value / 10.0**exponent, error / 10.0**exponent
        return f"({plus_minus(scaled, scaled_error)})e{exponent}"
    return " +- ".join(value_and_error(value, error))


def value_and_error(value: float, error: float) -> tuple[str, str]:
    """Both as `plus_minus` rounds them, each by itself and without a power of ten."""
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.6g}", f"{error:.2g}"
    decimals = _decimals(error)
    return _rounded(value, decimals), _rounded(error, decimals)


def two_digits(value: float) -> str:
    """A rate that was looked at for a moment, whose error nobody knows: 2000, 600, 23."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    return _rounded(value, 1 - math.floor(math.log10(abs(value))))


def _decimals(error: float) -> int:
    """Behind the point; negative before it."""
    exponent = math.floor(math.log10(error))
    leading = round(error / 10.0**exponent * 100)  # 100 to 1000
    if leading < 355:
        return 1 - exponent
    return -exponent  # 950 to 1000 becomes 10 of the next power: still one place


def _rounded(value: float, decimals: int) -> str:
    rounded = Decimal(repr(float(value))).quantize(Decimal(1).scaleb(-decimals), ROUND_HALF_UP)
    return f"{rounded + 0:.{max(decimals, 0)}f}"  # + 0: no -0.00

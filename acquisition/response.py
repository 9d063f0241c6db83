"""What an instrument makes of an instant of light, laser pulse, detector and counter together, and who says so."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

Floats = npt.NDArray[np.float64]
LONGEST_S = 1e-7
FAINTEST = 1e-4  # of the light: what lies farther out at either end is cut
GAUSSIAN_WIDTHS = 1.505  # 1 / integral of the square of a Gaussian of area 1 and FWHM 1


@dataclass(frozen=True)
class Response:
    """Shares of the light over equal steps of time, adding up to 1; time 0, on which light is timed, is the maximum.

    The middle of step k is (k - zero) steps after it.
    """

    shares: Floats  # (K,)
    step_s: float
    zero: float
    source: str
    """Where it is from, in words: "a Gaussian of 300 ps, as given"."""

    def __post_init__(self) -> None:
        if self.shares.ndim != 1 or not np.isfinite(self.shares).all() or (self.shares < 0).any():
            raise InvalidData(f"the response ({self.source}) is not a row of finite numbers of 0 and more")
        if not (self.step_s > 0 and self.shares.size * self.step_s <= LONGEST_S and np.isfinite(self.zero)):
            raise InvalidData(
                f"the response ({self.source}) has {self.shares.size} steps of {self.step_s:g} s; "
                f"up to {LONGEST_S * 1e9:g} ns in all make sense"
            )
        if abs(self.shares.sum() - 1) > 1e-6:
            raise InvalidData(f"the response ({self.source}) adds up to {self.shares.sum():g}, not to 1")

    @property
    def fwhm_s(self) -> float:
        """Full width at half maximum, as `full_width_steps` has it."""
        return full_width_steps(self.shares) * self.step_s

    def taps(self, bin_width_s: float) -> Floats:
        """Shares in bins of `bin_width_s` (K,), K odd, the middle bin centred on time 0."""
        edges = (np.arange(self.shares.size + 1) - 0.5 - self.zero) * self.step_s / bin_width_s
        running = np.concatenate([[0.0], np.cumsum(self.shares)])
        inside = np.interp([FAINTEST, 1 - FAINTEST], running, edges)
        reach = max(int(np.ceil(np.abs(inside).max() - 0.5)), 0)
        values = np.diff(np.interp(np.arange(-reach, reach + 2) - 0.5, edges, running))
        return np.asarray(values / values.sum())


def full_width_steps(shares: Floats) -> float:
    """Full width at half maximum of a row of shares (K,), in its steps: between the outermost crossings of half the
    maximum, on straight lines from step to step, and to no light before the first and after the last."""
    row, half = np.pad(shares, 1), shares.max() / 2
    above = np.flatnonzero(row >= half)
    first, last = int(above[0]), int(above[-1])
    before = (row[first] - half) / (row[first] - row[first - 1])
    after = (row[last] - half) / (row[last] - row[last + 1])
    return float(last - first + before + after)


def gaussian(fwhm_s: float, source: str) -> Response:
    """A Gaussian of that full width at half maximum. Raises `InvalidData` for one that nobody can have measured."""
    if not (np.isfinite(fwhm_s) and 0 < fwhm_s <= LONGEST_S / 4):
        raise InvalidData(f"a response of {fwhm_s * 1e12:g} ps ({source}): above 0 and up to 25000 ps make sense")
    steps = 48
    place = np.arange(-2 * steps, 2 * steps + 1) / steps
    curve = np.exp2(-4 * place**2)
    return Response(curve / curve.sum(), fwhm_s / steps, 2.0 * steps, source)


def measured(curve: npt.ArrayLike, step_s: float, source: str, zero: float | None = None) -> Response:
    """A measured curve without background; what is below 0 counts as 0. `zero`: the step of time 0, its maximum unless
    given. Raises `InvalidData` for one without light."""
    values = np.asarray(curve, dtype=np.float64)
    if values.ndim != 1 or not np.isfinite(values).all():
        raise InvalidData(f"the response ({source}) is not one row of finite numbers")
    values = np.maximum(values, 0.0)
    if not values.sum() > 0:
        raise InvalidData(f"the response ({source}) holds no light")
    return Response(values / values.sum(), step_s, float(values.argmax()) if zero is None else zero, source)


def as_json(response: Response | None) -> dict[str, object] | None:
    """What a recording keeps of the response that its source stated."""
    if response is None:
        return None
    shares = [float(share) for share in response.shares]
    return {"shares": shares, "step_s": response.step_s, "zero": response.zero, "source": response.source}


def from_json(stored: object) -> Response | None:
    """The reverse of `as_json`. Raises `InvalidData` for anything else."""
    if stored is None:
        return None
    try:
        fields = dict(stored)  # type: ignore[call-overload]
        shares = np.asarray(fields["shares"], dtype=np.float64)
        return Response(shares, float(fields["step_s"]), float(fields["zero"]), str(fields["source"]))
    except (LookupError, TypeError, ValueError) as error:
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"the response cannot be read ({error}). Import the original file again.") from error


def stated(curve: npt.ArrayLike | None, bin_width_s: float | None, fwhm_ps: float | None, name: str) -> Response | None:
    """What the file `name` states: a curve over bins, else a width, else nothing. Raises `InvalidData`."""
    if curve is not None:
        if bin_width_s is None or not (np.isfinite(bin_width_s) and bin_width_s > 0):
            raise InvalidData(
                f"{name}: response_bin_width_s is {bin_width_s}; beside `response` the width of its bins is expected, "
                "in seconds"
            )
        return measured(curve, bin_width_s, f"{name}: response")
    return None if fwhm_ps is None else gaussian(fwhm_ps * 1e-12, f"{name}: response_fwhm_ps")

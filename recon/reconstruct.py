"""From a transient to a reconstruction, by any method of the catalogue."""

import logging
import math
import time as clock
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import MOST_COUNTS, SPEED_OF_LIGHT_M_PER_S, TimeAxis, Transient
from nlos.configs.settings import Settings
from nlos.recon.errors import InvalidData, InvalidSettings, NoLight, ReconstructionFailed
from nlos.recon.explained import explained_light
from nlos.recon.explained_share import Explained, blame_response
from nlos.recon.gridding import confidence
from nlos.recon.lit_window import lit_window
from nlos.recon.memory import KnownMemory, available_bytes, refusal
from nlos.recon.method import MethodResult, takes_response
from nlos.recon.methods import catalogue, find, parse_settings, torch_is_installed
from nlos.recon.other_geometry import TELLING
from nlos.recon.own_methods import name_of
from nlos.recon.physics_settings import LightConeSettings, PhysicsSettings
from nlos.recon.transport.conventions import depths_m
from nlos.recon.volume import Intervals, Reconstruction, Volume, refuse_not_finite

Image = npt.NDArray[np.float32]
_log = logging.getLogger(__name__)
FAINT = 1e-9
"""The brightest bin of an array that is shown to methods in larger units."""
PUBLISHED_BIN_WIDTH_S = 16e-12  # two halvings of 4 ps: O'Toole et al. 2018, Lindell et al. 2019


def reconstruct(
    transient: Transient,
    method: str,
    settings: Mapping[str, object] | None = None,
    device: str = "cpu",
    *,
    explain: bool = True,
    elsewhere: bool = False,
) -> Reconstruction:
    """What `method`, a name or a file that ends in `.py`, sees in `transient` (time 0 at the wall, no direct light);
    and how much of the light that explains, unless `explain` is False. With `elsewhere` it is asked, too, whether
    a wall of another size would explain more, of methods that can tell (`other_geometry.TELLING`), and, where it is
    little, whether no response would.

    Raises `InvalidData` for counts nobody can reconstruct, `InvalidSettings` for a method or setting that does not
    exist, `ReconstructionFailed` where memory or the method does not reach, or what it makes is not finite.
    """
    chosen = parse_settings(method, dict(settings or {}))
    check(transient)
    rebinned = rebin(transient, _bin_width_s(chosen, transient))
    if isinstance(chosen, KnownMemory) and device == "cpu":
        free = available_bytes()
        told = rebinned.response is not None
        needed = chosen.bytes_needed(rebinned.wall, rebinned.time, told)
        remedies = chosen.smaller(rebinned.wall, rebinned.time, free, told)
        if why := refusal(method, rebinned.wall, rebinned.time, needed, free, remedies):
            raise ReconstructionFailed(why)
    weights_sha256 = _weights_sha256(chosen)
    began = clock.perf_counter()
    made, planes_m, takes = _see(rebinned, method, chosen, device, say=True)
    seconds = clock.perf_counter() - began
    if _weights_sha256(chosen) != weights_sha256:
        raise InvalidSettings(
            f"weights={getattr(chosen, 'weights', None)}: the file has changed while a picture was made by it, so "
            "nobody knows by which. Take a copy of the file that a training writes, or call again."
        )
    known = getattr(made, "intervals", None)
    result = Reconstruction(
        albedo=made.albedo.astype(np.float32),
        depth_m=made.depth_m.astype(np.float32),
        wall=rebinned.wall,
        method=name_of(method),
        seconds=seconds,
        settings=chosen.model_dump(mode="json"),
        volume=None if made.volume is None else Volume(made.volume, planes_m, rebinned.wall),
        weights_sha256=weights_sha256,
        intervals=None if known is None else Intervals(**known),
        confidence=confidence(rebinned.exposure_s),
        points=int(np.count_nonzero(rebinned.exposure_s > 0)),
        photons=max(float(rebinned.counts.sum(dtype=np.float64)), 0.0),
        response=rebinned.response,
        response_used=rebinned.response is not None and takes,
    )
    refuse_not_finite(result)
    if not explain:
        return result
    found = explained(transient, method, settings, device, elsewhere=elsewhere)
    if elsewhere and found.little and transient.response is not None:
        without = explained(replace(transient, response=None), method, settings, device)
        found = blame_response(found, without, transient.response.source)
    return replace(result, explained=found)


def get_ready(transient: Transient, method: str, settings: Mapping[str, object] | None = None) -> None:
    """Builds what `reconstruct` needs for such a transient, where it is kept from one call to the next: then the next
    one does not wait for weights. Raises `InvalidSettings`."""
    if torch_is_installed():
        from nlos.recon.with_torch import get_ready_for

        chosen = parse_settings(method, dict(settings or {}))
        get_ready_for(method, chosen, _looked_at(rebin(transient, _bin_width_s(chosen, transient)), chosen))


def explained(
    transient: Transient,
    method: str,
    settings: Mapping[str, object] | None = None,
    device: str = "cpu",
    *,
    elsewhere: bool = False,
) -> Explained:
    """What a picture of a part of `transient`, in the bins that it came in, explains of the rest: added up, a bin's
    light passes for noise. Without averages over mirror images, for speed. `elsewhere` as for `reconstruct`, but for
    the response, which pictures that are made again and again do not look for. Raises `InvalidSettings`."""
    chosen = parse_settings(method, dict(settings or {}))
    quick = chosen.model_copy(update={"symmetries": False}) if hasattr(chosen, "symmetries") else chosen
    falloff = getattr(chosen, "falloff", None)

    def see(part: Transient) -> tuple[Image, Image]:
        made, _, _ = _see(part, method, quick, device)
        if not np.isfinite(made.albedo).all() or np.isinf(made.depth_m).any():
            raise ReconstructionFailed("numbers that are not finite")
        return made.albedo, made.depth_m

    falloffs = (4.0, 2.0) if falloff is None else (float(falloff),)
    asked = elsewhere and name_of(method) in TELLING
    return explained_light(
        transient, see, falloffs, lambda part: rebin(part, _bin_width_s(chosen, part)), elsewhere=asked
    )


def _see(
    transient: Transient, method: str, chosen: Settings, device: str, say: bool = False
) -> tuple[MethodResult[Image], npt.NDArray[np.float64], bool]:
    """What a method makes of one transient, the depths of its planes, (D,), and whether it takes a response."""
    if isinstance(chosen, LightConeSettings) and chosen.conventions == "physical":
        part = _looked_at(transient, chosen)
        made, _, takes = _see_all(part, method, chosen, device)
        dark = transient.time.bins - part.time.bins
        if dark and say:
            reach_m = (part.time.start_s + part.time.bins * part.time.bin_width_s) * SPEED_OF_LIGHT_M_PER_S / 2
            _log.info(
                "nothing stands out of the noise behind %.2f m: not looked at, but up to FAR of --depth-m", reach_m
            )
        if dark and made.volume is not None:
            made = MethodResult(made.albedo, made.depth_m, np.pad(made.volume, ((0, dark), (0, 0), (0, 0))))
        return made, depths_m(transient.time, chosen.conventions), takes
    return _see_all(transient, method, chosen, device)


def _looked_at(transient: Transient, chosen: Settings) -> Transient:
    """The part of its window that a method looks at."""
    if isinstance(chosen, LightConeSettings) and chosen.conventions == "physical":
        return lit_window(transient, chosen.farthest_m)
    return transient


def _see_all(
    transient: Transient, method: str, chosen: Settings, device: str
) -> tuple[MethodResult[Image], npt.NDArray[np.float64], bool]:
    """`_see` of the whole window. Arrays in units of which light is but a trace are seen in others: what keeps a
    method from dividing by nothing would be brighter than all of it."""
    brightest = float(max(transient.counts.max(initial=0), -transient.counts.min(initial=0)))
    if not 0 < brightest < FAINT or method not in catalogue():
        return _see_as_given(transient, method, chosen, device)
    scale = np.float32(2.0 ** min(-math.frexp(brightest)[1], 126))
    made, planes_m, takes = _see_as_given(replace(transient, counts=transient.counts * scale), method, chosen, device)
    if isinstance(chosen, PhysicsSettings):  # the others' brightest point is 1
        volume = None if made.volume is None else made.volume / scale
        made = MethodResult(made.albedo / scale, made.depth_m, volume)
    return made, planes_m, takes


def _see_as_given(
    transient: Transient, method: str, chosen: Settings, device: str
) -> tuple[MethodResult[Image], npt.NDArray[np.float64], bool]:
    if torch_is_installed():
        from nlos.recon.with_torch import see_by

        return see_by(method, chosen, transient, device)
    plain = cast(Any, find(method)).build(chosen, transient.wall, transient.time)
    return *_see_plainly(transient, plain), takes_response(plain)


def _weights_sha256(chosen: Settings) -> str | None:
    """Of the weights file of a learned method."""
    name = getattr(chosen, "weights", None)
    if name is None:
        return None
    from nlos.recon.weights.files import sha256_of

    return sha256_of(name)


def _bin_width_s(chosen: Settings, transient: Transient) -> float:
    """The width asked for; else the data's own, doubled while a bin stays thinner than a quarter of the wall's pixels.

    Thinner bins than that resolve nothing more - the pixels blur it - and let noise of the unused frequencies in. The
    authors' conventions double it up to the published programs' width.
    """
    width_s = transient.time.bin_width_s
    if not isinstance(chosen, PhysicsSettings):
        return width_s
    if chosen.bin_width_ps is not None:
        return chosen.bin_width_ps * 1e-12
    wall = transient.wall
    pitch_m = min(wall.width_m / wall.cols, wall.height_m / wall.rows)
    widest_s = pitch_m / (2 * SPEED_OF_LIGHT_M_PER_S) if chosen.conventions == "physical" else PUBLISHED_BIN_WIDTH_S
    while 2 * width_s <= widest_s * 1.001:
        width_s *= 2
    return width_s


def _see_plainly(transient: Transient, plain: Any) -> tuple[MethodResult[Image], npt.NDArray[np.float64]]:
    """What a method built for this wall and time axis makes of one transient, without torch."""
    told: tuple[npt.NDArray[np.float64], ...] = ()
    if transient.response is not None and takes_response(plain):
        told = (transient.response.taps(transient.time.bin_width_s),)
    return plain(transient.counts.astype(np.float32, copy=False), transient.exposure_s, *told), plain.depths_m


def check(transient: Transient) -> None:
    """Raises `InvalidData` for counts that are not finite or hold no light, saying where.

    Single counts may be below 0: corrections subtract a mean background.
    """
    counts = transient.counts
    finite = np.isfinite(counts)
    if not finite.all():
        bin_, row, col = (int(i) for i in np.argwhere(~finite)[0])
        raise InvalidData(
            f"{int((~finite).sum())} of {counts.size} counts are not finite, the first in bin {bin_} of row {row}, "
            f"column {col}. Mark that point as not measured (exposure 0) or scan it again."
        )
    if max(float(counts.max()), -float(counts.min())) > MOST_COUNTS:
        bin_, row, col = (int(i) for i in np.unravel_index(np.abs(counts).argmax(), counts.shape))
        raise InvalidData(
            f"{float(counts[bin_, row, col]):.3g} in bin {bin_} of row {row}, column {col} is more than anybody counts "
            f"({MOST_COUNTS:.2g}). Store what was counted."
        )
    if not counts.any():
        raise NoLight(
            "every count is 0. Check that the shutter was open and that the direct cut does not remove everything."
        )
    total = float(counts.sum(dtype=np.float64))
    if total < 0:
        raise NoLight(
            f"the counts add up to {total:g}, below 0: there is no light above the background that was subtracted. "
            "Check the background, that these are counts, and that hidden light comes within the time window, behind "
            "the direct light."
        )
    if not (np.isfinite(transient.exposure_s).all() and (transient.exposure_s >= 0).all()):
        raise InvalidData("exposures must be finite and not negative; 0 marks a point as not measured.")
    if not (transient.exposure_s > 0).any():
        raise InvalidData("no point of the wall was measured: every exposure is 0.")


def rebin(transient: Transient, bin_width_s: float) -> Transient:
    """Adds up bins to `bin_width_s`, a whole multiple of what they are; what is left over at the end is dropped.

    Raises `InvalidData` where it is not a multiple or more than there is.
    """
    time = transient.time
    factor = round(bin_width_s / time.bin_width_s)
    if factor < 1 or abs(factor * time.bin_width_s - bin_width_s) > 1e-3 * time.bin_width_s or factor > time.bins:
        multiples = ", ".join(f"{time.bin_width_s * k * 1e12:g}" for k in (1, 2, 4))
        raise InvalidData(
            f"bins of {time.bin_width_s * 1e12:g} ps cannot be added up to {bin_width_s * 1e12:g} ps. "
            f"Use a whole multiple: {multiples} ..."
        )
    if factor == 1:
        return transient
    bins = time.bins // factor
    rows, cols = transient.wall.rows, transient.wall.cols
    summed = transient.counts[: bins * factor].reshape(bins, factor, rows, cols).sum(1, dtype=np.float32)
    return replace(transient, counts=summed, time=TimeAxis(bins, time.bin_width_s * factor, time.start_s))

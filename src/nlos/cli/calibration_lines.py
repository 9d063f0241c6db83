"""What `nlos calibrate RUN` prints: every number once, with its error; what does not go together as a warning."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.digits import plus_minus
from nlos.calibration.spots_fit import OFFSETS, poorly_determined
from nlos.calibration_told import cut_by_the_window
from nlos.cli.spots import aside_lines, fitted_lines, spots_line, undetermined_line
from nlos.light_left_out import hidden_by_the_tail

if TYPE_CHECKING:
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.geometry_fit import GeometryFit, Spots
    from nlos.calibration.measure import Measurement

Lines = list[tuple[str, dict[str, object]]]
MM_PER_PS = 0.299792458 / 2
"""Depth of a picosecond there and back."""


def result_lines(found: "Measurement", spots: "Spots | None") -> Lines:
    """What is printed, each line with its part of the JSON document."""
    constants = found.constants
    lines: Lines = []
    if found.corrected is not None:
        lines += _timing_lines(found.corrected.report())
        lines += _place_of_arrivals(constants) if found.geometry is None else _geometry_lines(found, spots)
        lines += _drift_lines(found)
    else:
        lines.append(("no laser light in these runs: taken as runs with the shutter closed", {}))
    background = "clicks/s between the pulses of a scan: room light and dark counts"
    if constants.dark_hz is not None:
        background = "clicks/s between the pulses of a scan beyond those with the shutter closed"
    if constants.afterpulse_probability is None:
        background += ", afterpulses included"
    for name, unit, scale in (
        ("dark_hz", "clicks/s with the shutter closed: dark counts and room light", 1.0),
        ("ambient_hz", background, 1.0),
        ("dead_time_s", "ns dead time", 1e9),
        ("afterpulse_probability", "% afterpulses", 100.0),
    ):
        quantity = getattr(constants, name)
        if quantity is not None:
            text = f"{plus_minus(quantity.value * scale, quantity.error * scale)} {unit}"
            if name == "dead_time_s" and found.dead_time_measured and (period_s := _period_s(found)):
                text += f", or longer by the laser's period of {period_s * 1e9:.4g} ns: see the data sheet"
            lines.append((text, {name: quantity.value, f"{name}_error": quantity.error}))
    return lines


def _period_s(found: "Measurement") -> float | None:
    """Of the scans that the dead time was measured from."""
    return None if found.raw is None else found.raw.period_s


def warnings_of(found: "Measurement", spots: "Spots | None") -> list[str]:
    """What to look at before these constants are used."""
    said = [*found.constants.warnings, *([found.off_aim] if found.off_aim else [])]
    if found.corrected is not None:
        scan = cut_by_the_window(found.corrected.report()), hidden_by_the_tail(found.corrected)
        said += [each for each in scan if each]
    if found.placed is None:
        return said
    fit = found.placed.fit
    if spots is not None:
        said += aside_lines(fit, spots)
    loose = {name: (getattr(fit.geometry, name), fit.errors[name]) for name in poorly_determined(fit)}
    told = "these times" if spots is None else "these spots"
    said += [undetermined_line(name, value, error, told) for name, (value, error) in loose.items()]
    for name, (value, error) in found.placed.undetermined.items():
        if name not in OFFSETS:
            said.append(f"{undetermined_line(name, value, error)}; kept as the scan was aimed")
    return said


def _timing_lines(report: Mapping[str, object]) -> Lines:
    rms_ps, tail_ps, masked_ns = report["offset_rms_ps"], report["direct_tail_ps"], report["direct_masked_ns"]
    assert isinstance(rms_ps, float)
    masked = f"direct light masked for {masked_ns:.2f} ns" if masked_ns else "no bins masked for direct light"
    tail = f", its tail decays in {tail_ps:.0f} ps" if tail_ps else ", without a tail beyond that"
    return [
        (
            f"time offsets: {rms_ps:.2f} ps = {rms_ps * MM_PER_PS:.3f} mm RMS about the wall's fit "
            f"({report['offset_rms_bins']:.3f} bins; {report['points_off_the_wall_fit']} of {report['points']} points "
            f"off the fit, {report['points_without_direct_peak']} without a direct peak)",
            {key: report[key] for key in report if key.startswith(("offset", "points"))},
        ),
        (
            f"impulse response {report['response_fwhm_ps']:.0f} ps FWHM; {masked}{tail}",
            {key: report[key] for key in ("response_fwhm_ps", "direct_masked_ns", "direct_tail_ps")},
        ),
    ]


def _place_of_arrivals(constants: "BenchConstants") -> Lines:
    """Of a file that does not say at which angles it was taken: by the places of its points."""
    assert constants.arrivals is not None
    position, error = constants.arrivals.scanner_position_m, constants.arrivals.covariance.diagonal() ** 0.5
    delay_ns, delay_error_ns = constants.arrivals.delay_s * 1e9, error[3] * 1e9
    return [
        (
            f"scanner at {position[0]:+.4f}, {position[1]:+.4f}, {position[2]:.4f} m of the wall's centre "
            f"(+- {error[0] * 1e3:.1f}, {error[1] * 1e3:.1f}, {error[2] * 1e3:.1f} mm), "
            f"delay {delay_ns:.4f} +- {delay_error_ns:.4f} ns",
            {
                "scanner_position_m": position.tolist(), "scanner_position_error_m": error[:3].tolist(),
                "electronic_delay_ns": delay_ns, "electronic_delay_error_ns": delay_error_ns,
            },
        )
    ]  # fmt: skip


def _geometry_lines(found: "Measurement", spots: "Spots | None") -> Lines:
    placed = found.placed
    assert placed is not None
    fit = placed.fit
    rms_mm = float(np.sqrt(np.mean((fit.height_m[fit.accepted] * 1e3) ** 2)))
    geometry, delay_error_s = fit.geometry, fit.errors.get("delay_s", 0.0)
    place = [geometry.scanner_x_m, geometry.scanner_y_m, geometry.wall_distance_m]
    errors = [fit.errors.get(name) for name in ("scanner_x_m", "scanner_y_m", "wall_distance_m")]
    lines = fitted_lines(fit)
    lines += [
        (
            f"{'delay':<20} {fit.delay_s * 1e9:+.4f} +- {delay_error_s * 1e9:.4f} ns, the place's error included "
            f"({1 / MM_PER_PS:.1f} ps a mm)",
            {"electronic_delay_ns": fit.delay_s * 1e9, "electronic_delay_error_ns": delay_error_s * 1e9},
        ),
        (
            f"direct light {rms_mm:.3f} mm = {rms_mm / MM_PER_PS:.2f} ps RMS off a plane wall",
            {
                "wall_distance_m": geometry.wall_distance_m,
                "wall_pitch_deg": float(np.rad2deg(geometry.wall_pitch_rad)),
                "wall_yaw_deg": float(np.rad2deg(geometry.wall_yaw_rad)),
                "geometry": vars(geometry), "geometry_errors": dict(fit.errors),
                "wall_rms_mm": rms_mm, "wall_rms_ps": rms_mm / MM_PER_PS,
                "scanner_position_m": place, "scanner_position_error_m": errors,
                "undetermined": sorted({*placed.undetermined, *poorly_determined(fit)}), "freed": list(placed.freed),
            },
        ),
    ]  # fmt: skip
    if spots is not None:
        lines.append((spots_line(fit, spots), {"spots_rms_mm": fit.spots_rms_m * 1e3}))
        if placed.spots_alone is not None:
            lines.append(_alone_line(placed.spots_alone, placed.times_alone))
        lines.append((_as_told_line(placed.freed, placed.undetermined), {}))
    return lines


def _drift_lines(found: "Measurement") -> Lines:
    """Whether the time zero stayed while the points were taken, which a wall that leans may only seem to say."""
    drift = found.drift
    if drift is None:
        return []
    tilt_deg, seconds = float(np.rad2deg(drift.like_tilt_rad)), drift.last_s - drift.first_s
    if not drift.known:
        words = (
            "drift of the time zero: these points cannot tell it from the wall, for they were taken in the order of "
            f"their places; 10 ps over their {seconds:.3g} s would pass for {tilt_deg:.3f} deg of lean and "
            f"{drift.like_distance_m * 1e3:.1f} mm of distance. A scan in random order tells "
            "(pattern: {kind: random, points: 200})"
        )
        return [(words, {"drift_known": False, "lean_like_10_ps_deg": tilt_deg})]
    total_ps, error_ps = drift.total_s * 1e12, drift.error_s * 1e12
    words = f"drift of the time zero over the {seconds:.3g} s: {plus_minus(total_ps, error_ps)} ps"
    words += ", taken out of what is said of the wall" if drift.significant else ", no more than chance"
    values = {"drift_known": True, "drift_ps": total_ps, "drift_error_ps": error_ps, "drift_found": drift.significant}
    return [(words, dict(values))]


def _alone_line(spots: "GeometryFit", times: "GeometryFit | None") -> tuple[str, dict[str, object]]:
    names = ("scanner_x_m", "scanner_y_m", "wall_distance_m")
    place = [getattr(spots.geometry, name) for name in names]
    errors = [spots.errors.get(name, 0.0) for name in names]
    told = [f"{plus_minus(1e3 * m, 1e3 * error)} mm" for m, error in zip(place, errors, strict=True)]
    words = (
        f"told by the spots alone: scanner {told[0]} right of the wall's centre and {told[1]} above it, wall {told[2]} "
        "away"
    )
    if times is not None:
        by_times = plus_minus(1e3 * times.geometry.wall_distance_m, 1e3 * times.errors["wall_distance_m"])
        words += f"; by the direct times alone: wall {by_times} mm away"
    words += "; by both together: the lines above, with gains, offsets and delay"
    return words, {"spots_alone_m": place, "spots_alone_error_m": errors}


def _as_told_line(freed: tuple[str, ...], undetermined: Mapping[str, object]) -> str:
    if freed:
        words = f"the mirrors do not turn as told: {', '.join(name.removesuffix('_rad') for name in freed)} fitted"
    else:
        words = "the mirrors turn as told, as far as these points tell"
    kept = [f"{name[0]} offset" for name in OFFSETS if name in undetermined]
    return words + (f" ({' and '.join(kept)}: the same as a lean of the wall, left as it was)" if kept else "")

"""What is said of a scan's calibration: how well direct light tells its time 0, and what to do where it does not."""

import logging

from nlos.calibration.correct import CorrectedPoints
from nlos.calibration.correction_report import Report
from nlos.light_left_out import tell_of_light_left_out
from nlos.said_once import Tell

IF_RECTIFIED = (
    "If time 0 is the wall already and direct light is gone, say --rectified (in Python rectified=True): nothing is "
    "aligned then."
)


AT_THE_START = 0.1
"""Of the points: fewer pulses are cut by chance, or bridged by the wall."""


def cut_by_the_window(report: Report) -> str:
    """What to say of a record that begins amid direct light, which then tells no wall; empty of any other."""
    points, cut = report["points"], report["points_at_the_start"]
    if report["on_a_plane"] or not isinstance(points, int) or not isinstance(cut, int) or cut < AT_THE_START * points:
        return ""
    return (
        f"the record begins amid direct light: at {cut} of {points} points it comes in the first bins, and is cut "
        "off. Depths are off by that. Start the histogram a nanosecond earlier (histogram.offset_ns) and scan again, "
        "or give --constants of a scan of this bench that has all of its direct light"
    )


def tell_calibration(done: CorrectedPoints, tell: Tell) -> None:
    """How well a scan was aligned, and what light of it is not used."""
    _tell_arrivals(done.report(), tell)
    tell_of_light_left_out(done, tell)


def _tell_arrivals(report: Report, tell: Tell) -> None:
    rms_bins, points = report["offset_rms_bins"], report["points"]
    assert isinstance(points, int)
    if report["arrivals_known"]:
        tell(logging.INFO, "calibrated: by the constants' arrivals, as no direct light was found in the scan itself")
        return
    if report["off_the_drawing"]:
        tell(
            logging.WARNING,
            "direct light of %d points tells no wall by itself, and that of the bench file's geometry does not explain "
            "it: each point was aligned by what is brightest there. Is wall_distance_m right, and is a hidden object "
            "brighter than the wall? A scan of this bench that spans the wall tells: `nlos calibrate`, --constants",
            points,
        )  # fmt: skip
        return
    if not isinstance(rms_bins, float):
        spread_bins = report["arrival_spread_bins"]
        if points >= 9 and isinstance(spread_bins, float) and spread_bins < 1:
            tell(
                logging.INFO,
                "calibrated: direct light arrives at all %d points at the same time, which is taken for time 0", points,
            )  # fmt: skip
        elif points >= 9:
            tell(
                logging.INFO,
                "calibrated: no plane wall explains the arrivals at %d points; each was aligned by its own",
                points,
            )
        return
    masked_ns = report["direct_masked_ns"]
    masked = f"direct light masked up to {masked_ns:.2f} ns" if masked_ns else "no bins masked for direct light"
    tell(logging.INFO, "calibrated: offsets to %.1f ps RMS of the wall fit, %s", report["offset_rms_ps"], masked)
    if cut := cut_by_the_window(report):
        tell(logging.WARNING, "%s", cut)
    elif not report["on_a_plane"]:
        tell(
            logging.WARNING,
            "arrivals scatter by %.0f ps about a plane wall. Is the wall plane, does the time window hold its direct "
            "light, or is a hidden object brighter than that (a gated detector)? `nlos calibrate` draws them. Then "
            "time 0 has to be told: --constants of a scan with direct light, or --set offsets=file. %s",
            report["offset_rms_ps"],
            IF_RECTIFIED,
        )

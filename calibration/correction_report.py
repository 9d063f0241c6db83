"""What was found of a scan while it was corrected, in figures."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import TimeOffsets
from nlos.calibration.background import Background
from nlos.calibration.direct_reflection import DirectLight

Report = dict[str, float | int | list[float] | None]


def report_of(
    offsets: TimeOffsets | None,
    measured: npt.NDArray[np.bool_],
    direct: DirectLight,
    background: Background,
    bin_width_s: float,
) -> Report:
    """Figures for people and JSON: what was found, and how well it fits. `measured` (N,): which points were;
    `offsets`: None where the arrivals were given."""
    wall = offsets.wall if offsets else None
    rms_s = offsets.rms_bins * bin_width_s if offsets and wall else None
    return {
        "points": int(measured.sum()),
        "points_without_direct_peak": int((~offsets.found & measured).sum()) if offsets else None,
        "points_off_the_wall_fit": int((offsets.stray & measured).sum()) if offsets and wall else None,
        "offset_rms_bins": offsets.rms_bins if offsets and wall else None,
        "offset_rms_ps": rms_s * 1e12 if rms_s is not None else None,
        "offset_rms_mm": rms_s * SPEED_OF_LIGHT_M_PER_S / 2 * 1e3 if rms_s is not None else None,
        "arrivals_known": offsets is None,
        "points_at_the_start": int((offsets.cut & measured).sum()) if offsets else None,
        "off_the_drawing": offsets.off_the_drawing if offsets else None,
        "on_a_plane": offsets.on_a_plane if offsets and wall else None,
        "arrival_spread_bins": float(np.std(offsets.measured_bins[offsets.found])) if offsets else None,
        "scanner_position_m": [float(v) for v in wall.scanner_position_m] if wall else None,
        "electronic_delay_ns": wall.delay_s * 1e9 if wall else None,
        "response_fwhm_ps": offsets.response.fwhm_s() * 1e12 if offsets else None,
        "direct_masked_ns": direct.end_bin * bin_width_s * 1e9,
        "direct_tail_ps": direct.decay_bins * bin_width_s * 1e12,
        "background_per_bin": float(np.mean(background.per_bin)),
    }

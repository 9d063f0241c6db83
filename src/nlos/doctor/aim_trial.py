"""Where the beam goes, by somebody's eyes: to three places, and a ruler says where it came.

Arrival times cannot tell this: a scanner that stands aside, a reversed axis and two that are swapped leave every
distance as it was.
"""

import math
from collections.abc import Iterator

import numpy as np

from nlos.beam_seen import FAR_PART, RULER_M, keep_beam_seen
from nlos.by_hand.opening import aim_in_use
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry_fit import Spots
from nlos.calibration.spots_sense import check_sense
from nlos.doctor.area import area_of
from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.hands import hands_for
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.mirror import MirrorAngles

_MARK = "Mark nine spots with `nlos jog`; `nlos calibrate --spots FILE` says where the scanner stands."


def beam_seen(bench: Bench) -> Iterator[Finding]:
    """The middle of the area, a place to the right of it and one above."""
    area, hands = area_of(bench), hands_for(bench)
    (x_m, y_m), aim = area.centre, aim_in_use(bench.settings, {"mirror": bench.mirror, "counter": bench.counter})
    right_m, up_m = (area.right_m - x_m) / 2, (area.top_m - y_m) / 2
    rows: list[tuple[float, float, float, float]] = []
    off_m = (0.0, 0.0)
    for place in ((x_m, y_m), (x_m + right_m, y_m), (x_m, y_m + up_m)):
        x_rad, y_rad = aim.angles_rad(np.array([place[0]]), np.array([place[1]]))
        angles = MirrorAngles(float(x_rad[0]), float(y_rad[0]))
        bench.mirror.move_to(angles)
        seen = hands.spot(bench, place)
        if seen is None:
            bench.mirror.park()
            yield skipped("aim", "nobody measured where the beam lands on the wall; `nlos jog` marks spots")
            return
        rows.append((angles.x_rad, angles.y_rad, *seen))
        off_m = max(off_m, (seen[0] - place[0], seen[1] - place[1]), key=lambda each: math.hypot(*each))
    bench.mirror.park()
    spots = Spots(*np.array(rows).T)
    keep_beam_seen(bench.settings, "doctor", spots)
    try:
        check_sense(spots)
    except InvalidData as error:
        what, _, remedy = str(error).partition(";")[0].partition(": ")
        yield failed("aim", what, f"{remedy[:1].upper()}{remedy[1:].rstrip('.')}, and run the doctor again.")
        return
    distance_m = bench.settings.geometry.wall_distance_m
    said = f"the beam lands {off_m[0]:+.3f}, {off_m[1]:+.3f} m from where it was sent"
    if math.hypot(*off_m) > FAR_PART * distance_m:
        yield failed("aim", f"{said}: the scanner's place or the wall's distance is another", _MARK)
    elif math.hypot(*off_m) > RULER_M:
        yield warned("aim", said, _MARK)
    else:
        yield passed("aim", f"{said}, at most, at three places")

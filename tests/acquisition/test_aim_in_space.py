"""A scanner that stands aside, before a wall that leans: aimed at a point, the beam is there, by two other accounts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.planning.aim import Aim
from nlos.calibration.geometry import ScannerGeometry
from nlos.drivers.simulated.beam import BeamPath, Misalignment

PLACES = st.floats(-0.5, 0.5)
LEANS = st.floats(-15.0, 15.0)


@settings(max_examples=60, deadline=None)
@given(sx=PLACES, sy=PLACES, pitch=LEANS, yaw=LEANS, e=st.floats(0.0, 0.05), x=PLACES, y=PLACES)
def test_the_beam_is_where_it_is_aimed_at(
    sx: float, sy: float, pitch: float, yaw: float, e: float, x: float, y: float
) -> None:
    aim = Aim(1.42, e, sx, sy, np.deg2rad(pitch), np.deg2rad(yaw))
    angles = aim.angles(x, y)
    out_of_place = Misalignment(scanner_x_m=sx, scanner_y_m=sy, wall_pitch_deg=pitch, wall_yaw_deg=yaw)
    spot = BeamPath(1.42, e, out_of_place).spot(angles)
    assert spot is not None
    assert (spot.x_m, spot.y_m) == pytest.approx((x, y), abs=1e-9)
    assert aim.wall_point(angles) == pytest.approx((x, y), abs=1e-9)
    fitted = ScannerGeometry(**vars(aim))
    assert [float(each) for each in fitted.wall_points(angles.x_rad, angles.y_rad)] == pytest.approx([x, y], abs=1e-9)
    range_m = float(aim.ranges_m(np.float64(angles.x_rad), np.float64(angles.y_rad)))
    assert range_m == pytest.approx(spot.range_m, abs=1e-9)
    assert range_m == pytest.approx(float(fitted.ranges_m(angles.x_rad, angles.y_rad)), abs=1e-9)

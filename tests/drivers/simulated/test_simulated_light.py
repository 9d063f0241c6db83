"""The simulated light against closed forms, and against a photon-by-photon simulation of the detector."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated import spad
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath, Misalignment
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface, surfels

CENTRE = MirrorAngles(0.0, 0.0)
BIN_S = 32e-12
QUIET = DetectorSettings(dark_cps=0.0, dead_time_ns=0.0, tail_fraction=0.0)


def gate(number: int | None = 0, dwell_s: float = 8e-3, **more: object) -> Gate:
    return Gate(0.0, dwell_s, 512, BIN_S, 10e-9, number, **more)  # type: ignore[arg-type]


def light(scene: SceneSettings, detector: DetectorSettings = QUIET, **path: float) -> SceneLight:
    return SceneLight(scene, detector, BeamPath(2.0, **path), 10e6, seed=5)


def mean_arrival_s(rate: np.ndarray, offset_s: float) -> float:
    return float((rate * (np.arange(len(rate)) + 0.5)).sum() / rate.sum()) * BIN_S + offset_s


@pytest.mark.parametrize("x_rad", [-0.2, 0.0, 0.13])
@pytest.mark.parametrize("separation_m", [0.0, 0.012])
def test_direct_light_arrives_after_the_way_to_the_wall_and_back(x_rad: float, separation_m: float) -> None:
    path = BeamPath(2.0, separation_m)
    spot = path.spot(MirrorAngles(x_rad, 0.1))
    assert spot is not None
    assert spot.x_m == pytest.approx((2.0 / np.cos(0.1) + separation_m) * np.tan(x_rad))
    assert spot.y_m == pytest.approx(2.0 * np.tan(0.1))
    assert spot.range_m == pytest.approx((2.0 / np.cos(0.1) + separation_m) / np.cos(x_rad))
    scene = SceneSettings(direct_cps=1e5, ambient_cps=0.0, delay_ns=0.3)
    rate = light(scene, mirror_separation_m=separation_m).photons_per_pulse(spot, BIN_S, 10e-9)
    assert mean_arrival_s(rate, 10e-9) == pytest.approx(2 * spot.range_m / SPEED_OF_LIGHT_M_PER_S + 0.3e-9, abs=1e-13)


def test_a_tilted_wall_is_nearer_on_one_side() -> None:
    path = BeamPath(2.0, misalignment=Misalignment(wall_yaw_deg=10.0))
    left, right = path.spot(MirrorAngles(-0.1, 0.0)), path.spot(MirrorAngles(0.1, 0.0))
    assert left is not None
    assert right is not None
    assert left.range_m < 2.0 < right.range_m
    # Sine rule in the triangle scanner - wall centre - spot.
    assert right.x_m == pytest.approx(2.0 * np.sin(0.1) / np.cos(0.1 + np.radians(10.0)))


def test_hidden_light_follows_the_inverse_fourth_power_and_both_cosines() -> None:
    patch = Surface(panel_m=(0.01, 0.01), centre_m=(0.3, -0.1, 0.8), albedo=0.7, yaw_deg=20.0)
    scene = SceneSettings(objects=(patch,), direct_cps=0.0, hidden_cps=1e6, ambient_cps=0.0)
    spot = BeamPath(2.0).spot(CENTRE)
    rate = light(scene).photons_per_pulse(spot, BIN_S, 10e-9)
    r = np.linalg.norm(patch.centre_m)
    normal = np.array([np.sin(np.radians(20.0)), 0.0, -np.cos(np.radians(20.0))])
    factor = (patch.centre_m[2] / r) * float(-normal @ patch.centre_m) / r / r**2
    assert rate.sum() * 10e6 == pytest.approx(1e6 * 0.7 * 1e-4 * factor**2, rel=1e-6)
    assert mean_arrival_s(rate, 10e-9) == pytest.approx(2 * (2.0 + r) / SPEED_OF_LIGHT_M_PER_S, abs=1e-13)
    mirrorlike = SceneSettings.model_validate(
        scene.model_dump() | {"objects": (patch.model_copy(update={"retroreflective": True}),)}
    )
    rate = light(mirrorlike).photons_per_pulse(spot, BIN_S, 10e-9)
    assert rate.sum() * 10e6 == pytest.approx(1e6 * 0.7 * 1e-4 * factor, rel=1e-6)


def test_light_beyond_the_laser_period_comes_in_at_its_beginning() -> None:
    spot = BeamPath(2.0).spot(CENTRE)
    late = light(SceneSettings(direct_cps=1e5, ambient_cps=0.0, delay_ns=90.0)).photons_per_pulse(spot, BIN_S, 0.0)
    arrival_s = (4.0 / SPEED_OF_LIGHT_M_PER_S + 90e-9) % 100e-9
    assert mean_arrival_s(late, 0.0) == pytest.approx(arrival_s, abs=1e-13)


def test_surfaces_have_their_area_and_face_the_wall() -> None:
    sphere = surfels([Surface(sphere_m=0.2, centre_m=(0.0, 0.0, 1.0))], 0.01)
    assert sphere.reflectance_m2.sum() == pytest.approx(4 * np.pi * 0.04)
    assert np.linalg.norm(sphere.normals, axis=1) == pytest.approx(1.0)
    letter = surfels([Surface(letter="U", centre_m=(0.0, 0.0, 1.0), height_m=0.7)], 0.01)
    assert letter.reflectance_m2.sum() == pytest.approx(15 * 0.01)
    assert letter.normals == pytest.approx(np.broadcast_to([0.0, 0.0, -1.0], letter.normals.shape))
    drawn = surfels([Surface(bitmap=("#.", ".9", "0 "), centre_m=(0.0, 0.0, 1.0), height_m=0.3)], 0.05)
    left = drawn.positions_m[:, 0] < 0
    assert (drawn.positions_m[left, 1] > 0.05).all()
    assert drawn.reflectance_m2.sum() == pytest.approx(0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        {"letter": "S"},
        {"letter": "ß", "height_m": 1.0},
        {"letter": "S", "sphere_m": 1.0, "height_m": 1.0},
        {},
        {"panel_m": (0.0, 1.0)},
        {"bitmap": ("..",), "height_m": 0.1},
        {"sphere_m": 1.5},
    ],
)
def test_a_surface_that_says_too_little_or_too_much_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="Value error"):
        Surface.model_validate({"centre_m": (0.0, 0.0, 1.0), **wrong})


def test_same_point_same_photons_and_other_points_others() -> None:
    source = light(SceneSettings())
    first, again, other = source(gate(3), CENTRE, True), source(gate(3), CENTRE, True), source(gate(4), CENTRE, True)
    assert (first.counts == again.counts).all()
    assert (first.counts != other.counts).any()
    unnumbered = source(gate(None), CENTRE, True)
    assert (unnumbered.counts == source(gate(None), CENTRE, True).counts).all()
    assert (unnumbered.counts != source(gate(None), MirrorAngles(1e-3, 0.0), True).counts).any()


def test_a_closed_shutter_leaves_dark_and_ambient_counts() -> None:
    source = light(SceneSettings(ambient_cps=2e4), QUIET.model_copy(update={"dark_cps": 1e4}))
    closed = source(gate(dwell_s=1.0), CENTRE, False)
    assert closed.total_count == pytest.approx(3e4, abs=5 * 3e4**0.5)
    assert closed.counts.sum() == pytest.approx(3e4 * 512 * BIN_S * 10e6, abs=400)


@pytest.mark.parametrize(
    ("dead_ns", "afterpulses", "brightest"),
    [(30.0, 0.0, 0.15), (77.0, 0.0, 0.15), (250.0, 0.0, 0.15), (60.0, 0.1, 0.15), (60.0, 0.3, 0.15), (30.0, 0.0, 1.0),
     (40.0, 0.1, 1.0), (250.0, 0.1, 1.0)],
)  # fmt: skip
def test_dead_time_and_afterpulses_agree_with_photons_followed_one_by_one(
    dead_ns: float, afterpulses: float, brightest: float
) -> None:
    bins, pulses = 50, 200_000
    bin_s, period_s = 2e-9, 100e-9
    detector = DetectorSettings(
        dead_time_ns=dead_ns, afterpulse_probability=afterpulses, afterpulse_ns=20.0, dark_cps=0.0
    )
    photons = np.full(bins, 0.002)
    photons[10], photons[30] = brightest, 0.08
    rng = np.random.default_rng(1)
    drawn = rng.poisson(photons * pulses)
    times = (np.repeat(np.arange(bins), drawn) + rng.random(drawn.sum())) * bin_s
    times += rng.integers(0, pulses, drawn.sum()) * period_s
    pending = sorted(times)[::-1]
    seen = np.zeros(bins)
    ready_s = 0.0
    while pending:
        when_s = pending.pop()
        if when_s < ready_s:
            continue
        seen[int(when_s % period_s / bin_s)] += 1
        ready_s = when_s + dead_ns * 1e-9
        if rng.random() < afterpulses:
            extra_s = ready_s + rng.exponential(20e-9)
            place = len(pending)
            while place and pending[place - 1] < extra_s:
                place -= 1
            pending.insert(place, extra_s)
    expected = spad.distort(photons, bin_s, detector) * pulses
    assert expected.sum() == pytest.approx(seen.sum(), rel=0.02)
    assert (np.abs(expected - seen) < 6 * np.sqrt(expected) + 0.02 * expected).all()


@pytest.mark.parametrize("photons", [10.0, 100.0])
@pytest.mark.parametrize("dead_ns", [20.0, 77.0, 99.0, 150.0])
@pytest.mark.parametrize("afterpulses", [0.0, 0.05])
def test_a_detector_in_far_too_much_light_clicks_no_more_than_it_can(
    photons: float, dead_ns: float, afterpulses: float
) -> None:
    detector = DetectorSettings(dead_time_ns=dead_ns, afterpulse_probability=afterpulses)
    pulse = np.exp(-(((np.arange(1562) - 140) / 20) ** 2))
    clicks = spad.distort(1e-7 + photons * pulse / pulse.sum(), 64e-12, detector)
    assert (clicks >= 0).all()
    assert 0.3 < clicks.sum() < 1.1 * max(1562 * 64e-3 / dead_ns, 1.0)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 400), st.integers(0, 2**31))
def test_stopping_at_counts_leaves_exactly_that_many_in_the_window(stop: int, number: int) -> None:
    source = light(SceneSettings(direct_cps=2e4, hidden_cps=0.0), QUIET)
    whole = source(gate(number), CENTRE, True)
    stopped = source(gate(number, stop_counts=stop, stop_window=(90, 120)), CENTRE, True)
    assert stopped.stopped_early == (whole.counts[90:120].sum() >= stop)
    assert (stopped.counts <= whole.counts).all()
    if stopped.stopped_early:
        assert stopped.counts[90:120].sum() == stop
        assert 0 < stopped.live_s <= 8e-3
        assert stopped.sync_count == round(stopped.live_s * 10e6)
        assert stopped.total_count >= stopped.counts.sum()
    else:
        assert (stopped.counts == whole.counts).all()


def test_the_last_count_stops_too() -> None:
    source = light(SceneSettings(direct_cps=2e4, hidden_cps=0.0), QUIET)
    arrived = int(source(gate(1), CENTRE, True).counts.sum())
    assert source(gate(1, stop_counts=arrived), CENTRE, True).stopped_early
    assert not source(gate(1, stop_counts=arrived + 1), CENTRE, True).stopped_early


def test_a_part_of_the_clicks_is_late_by_the_diffusion_tail() -> None:
    detector = DetectorSettings(jitter_fwhm_ps=70.0, tail_fraction=0.2, tail_ps=300.0)
    first, share = spad.Response(detector).pulse(0.0, 1e-12)
    time_ps = first + np.arange(len(share)) + 0.5
    assert share.sum() == pytest.approx(1.0)
    assert (share * time_ps).sum() == pytest.approx(0.2 * 300.0, abs=1.0)
    assert share[time_ps > 500].sum() == pytest.approx(0.2 * np.exp(-500 / 300), rel=0.02)


def test_the_live_time_until_a_count_is_reached_follows_the_rate() -> None:
    source = light(SceneSettings(direct_cps=1e5, hidden_cps=0.0, ambient_cps=0.0), QUIET)
    lives = [source(gate(n, stop_counts=50), CENTRE, True).live_s for n in range(400)]
    assert np.mean(lives) == pytest.approx(50 / 1e5, rel=0.03)


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=40), st.integers(0, 2**31))
def test_photons_in_order_of_arrival_histogram_to_the_counts_they_came_from(counts: list[int], seed: int) -> None:
    exposure = Exposure(np.array(counts, dtype=np.uint32), 1e-3, 10_000, sum(counts), False)
    pulses, bins = spad.arrivals(exposure, np.random.default_rng(seed))
    assert (np.bincount(bins, minlength=len(counts)) == exposure.counts).all()
    assert (np.diff(pulses) >= 0).all()
    assert pulses.max(initial=0) < 10_000

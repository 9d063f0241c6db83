"""What the doctor makes of a mirror's settling where there is little light: it says so, and never more than it saw."""

import math

import pytest

from nlos.cli.benches import load_bench
from nlos.doctor.findings import Finding
from nlos.doctor.gates import Arrival
from nlos.doctor.light_trials import settle_curve
from nlos.drivers.bench import open_bench
from nlos.drivers.simulated.servo import ServoSettings

SLOW = ServoSettings(bandwidth_hz=150.0)
"""Such a head is 12 % of the step away when its table says that it has settled, and 1 % two milliseconds later."""


def settling(seed: int, direct_cps: float, ambient_cps: float, servo: ServoSettings | None = None) -> Finding:
    settings = load_bench(None).settings
    simulation = settings.simulation
    assert simulation is not None
    scene = simulation.scene.model_copy(update={"direct_cps": direct_cps, "ambient_cps": ambient_cps, "surfel_m": 0.1})
    changes = {"seed": seed, "scene": scene} | ({} if servo is None else {"servo": servo})
    simulation = simulation.model_copy(update=changes)
    with open_bench(settings.model_copy(update={"simulation": simulation})) as bench:
        (found,) = settle_curve(bench)
    return found


@pytest.mark.parametrize("servo", [None, SLOW], ids=["healthy", "slow"])
@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [1, 2])
def test_slices_with_too_few_photons_tell_nothing_but_how_long_it_would_take(
    seed: int, servo: ServoSettings | None
) -> None:
    found = settling(seed, 800.0, 3000.0, servo)
    assert found.verdict == "WARN"
    assert "too little direct light to see the mirror settle: 1" in found.said
    told_s = int(found.said.rpartition("it would take some ")[2].removesuffix(" s"))
    assert 3 <= told_s <= 60


def test_light_of_which_each_slice_has_enough_for_its_place_only_vaguely_passes_no_slow_head() -> None:
    """Within an eighth of the step, where the slow one is when its table is over."""
    assert settling(1, 5000.0, 30000.0).verdict == "WARN"
    assert settling(1, 5000.0, 30000.0, SLOW).verdict in ("WARN", "FAIL")


def test_with_ten_times_the_light_both_are_told_apart() -> None:
    assert settling(1, 10000.0, 3000.0).verdict == "PASS"
    assert settling(1, 10000.0, 3000.0, SLOW).verdict == "FAIL"


def test_what_is_foretold_is_enough() -> None:
    """Of a sum of twelve gates: with so many times the photons, as much background, each of them tells."""
    for photons, background in ((60.0, 0.0), (60.0, 240.0), (6000.0, 24.0), (300.0, 3000.0)):
        found = Arrival(13e-9, 30e-12 * math.sqrt(photons + background) / photons, photons, background)
        times = found.longer(10e-12, 12)
        enough = Arrival(13e-9, found.error_s / math.sqrt(times), photons * times, background * times)
        assert enough.longer(10.0001e-12, 12) == 1
        assert (
            times == 1
            or Arrival(
                13e-9, found.error_s / math.sqrt(times / 1.3), photons * times / 1.3, background * times / 1.3
            ).longer(10e-12, 12)
            > 1
        )

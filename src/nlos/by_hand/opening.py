"""A bench opened for hands: who is there, by what geometry it is aimed, and whether it may have light."""

from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from typing import TYPE_CHECKING

from nlos.acquisition.planning.preflight import drawn_aim
from nlos.bench_constants import aiming_constants
from nlos.by_hand.hand import Hand, refused_light
from nlos.by_hand.keys import keys_of_terminal
from nlos.by_hand.stops import Stops
from nlos.by_hand.trust import watch_first_moves
from nlos.calibration.errors import StaleConstants
from nlos.cli.agreeing import agrees, somebody_is_there
from nlos.cli.benches import wire_logged
from nlos.cli.terminal import terminal
from nlos.drivers.errors import DeviceError, LimitError, SafetyTrip
from nlos.drivers.partial_bench import PartialBench, open_partial_bench
from nlos.drivers.trip_latch import TripLatch

if TYPE_CHECKING:
    from nlos.acquisition.planning.aim import Aiming
    from nlos.configs.load import Loaded
    from nlos.drivers.bench_settings import BenchSettings
    from nlos.drivers.galvo.mirror import GalvoMirror
    from nlos.drivers.tcspc.counter import HistogramCounter


@contextmanager
def in_hand(
    table: "Loaded[BenchSettings]", wanted: Set[str], light_s: float | None = None, light_elsewhere: bool = False
) -> Iterator[Hand]:
    """The bench until the block is left; then the light is off, the mirror parked and the terminal as it was.

    `light_s`: what will be asked for, so that everything that stands against it is said before anything moves.
    """
    settings, latch = table.settings, TripLatch.of_bench(table.settings)
    with (
        wire_logged() as log,
        open_partial_bench(
            settings, wanted, light_elsewhere=light_elsewhere, wire_log=log, latch=latch, agree=agrees
        ) as bench,
    ):
        for role in sorted(wanted & bench.absent.keys()):
            terminal.log(f"continuing without the {role}: {bench.absent[role]}")
        why = why_no_light(bench)
        if light_s is not None and why:
            raise refused_light(settings.shutter_on != "nothing", why, "Without --light everything else is done.")
        if bench.mirror is not None and "mirror" in wanted:
            watch_first_moves(bench)
        stops = Stops()
        with stops.caught(), keys_of_terminal(stops) as keys:
            hand = Hand(bench, aim_in_use(settings, {"mirror": bench.mirror, "counter": bench.counter}), keys, stops)
            hand.no_light = why
            if light_s is not None:
                hand.light.check(light_s)
            with hand.light.timed():
                try:
                    yield hand
                except DeviceError:  # the exchange that a late timer cut in two is no fault of the instrument's
                    hand.light.answer()
                    raise
                finally:
                    hand.light.end("nobody is there any more")
                hand.light.answer()


def aim_in_use(settings: "BenchSettings", there: Mapping[str, "GalvoMirror | HistogramCounter | None"]) -> "Aiming":
    """As scans of this bench are aimed: by its constants where they rest on spots and still hold, else as drawn.
    `there`: role -> who answers."""
    drawn = drawn_aim(settings.geometry)
    names = {role: one.identity.name for role, one in there.items() if one is not None}
    try:
        known = aiming_constants(None, settings.model_dump_json(), names)
    except StaleConstants as error:
        terminal.log(f"aimed by the bench file's geometry: {error}")
        return drawn
    if known is None or known.constants.geometry is None:
        return drawn
    terminal.log(known.said(drawn))
    return known.constants.geometry


def why_no_light(bench: PartialBench) -> str:
    """Why this bench has no light for whoever is at this terminal; empty where it has. Asks what has to be asked, once
    and before a screen is drawn."""
    if bench.settings.shutter_on == "nothing":
        return "this bench has no shutter: nothing here switches the light on or off."
    if bench.shutter is None:
        return "what drives the shutter does not answer."
    if bench.settings.safety.dry_run:
        return "safety.dry_run is set in the bench file."
    power_mw = bench.settings.alignment.power_mw
    try:
        bench.shutter.check_trip()
        bench.shutter.agree()
    except SafetyTrip as trip:
        return f"{trip.what.removeprefix('stays closed ')} {trip.remedy}"
    except LimitError as error:
        return error.what.removeprefix("stays closed: ")
    if power_mw is not None and not bench.settings.simulated:
        if not somebody_is_there():
            return f"no one is at a terminal to confirm that the laser is at {power_mw:g} mW (alignment.power_mw)."
        if not agrees(f"Turn the laser down to {power_mw:g} mW, the bench file's alignment power.", "done"):
            return f"the laser was not turned down to {power_mw:g} mW."
    return ""

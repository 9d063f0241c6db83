"""A bench's constants: kept by its name, not by folder; the newest, unless the bench has changed since."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import degrees
from pathlib import Path

from nlos.acquisition.planning.aim import Aiming
from nlos.calibration.bench_facts import INSTRUMENTS, REAL, Facts, facts_of
from nlos.calibration.checked import all_checked, load_checked, measured_at
from nlos.calibration.constants import BenchConstants
from nlos.calibration.errors import StaleConstants
from nlos.calibration.geometry import ScannerGeometry
from nlos.drivers.file_word import older_word, own_word
from nlos.drivers.state_folder import state_folder

log = logging.getLogger(__name__)

NONE = Path("none")
"""What `--constants` takes for: none at all."""


@dataclass(frozen=True)
class Known:
    """Constants of a bench. `stale`: what has changed since, where a person named them all the same."""

    path: Path
    constants: BenchConstants
    stale: tuple[str, ...] = ()

    def said(self, drawn: Aiming | None = None) -> str:
        """Which they are, and where they go before the bench file: both values."""
        words = f"constants: {self.path}, measured {self.constants.measured_utc}"
        if drawn is not None and (instead := overrides(self.constants, drawn)):
            words += f"; in place of the bench file: {', '.join(instead)}"
        for warning in self.constants.warnings:
            words += f"; when they were measured: {warning}"
        return words

    @property
    def warning(self) -> str:
        """What to say of stale ones; empty otherwise."""
        if not self.stale:
            return ""
        return f"{self.path}: the bench has changed since these constants were measured: {'; '.join(self.stale)}"


def folder_of(bench: str) -> Path:
    """Where `nlos calibrate` keeps the constants of the bench of that name."""
    return state_folder() / "constants" / own_word(bench)


def _kept_for(bench: str) -> list[tuple[Path, BenchConstants]]:
    """Those that say they are of that bench, the newest first; earlier versions kept several benches in one folder."""
    folders = dict.fromkeys((folder_of(bench), folder_of(bench).with_name(older_word(bench))))
    found = [each for folder in folders for each in all_checked(folder) if each[1].bench == bench]
    return sorted(found, key=lambda each: measured_at(each[1]), reverse=True)


def measured_later(path: Path, bench: str) -> Path | None:
    """Of the constants of that bench, those that say they are newer than these at `path`, which were measured just now:
    a computer whose clock was wrong wrote one of them."""
    when = {kept: measured_at(constants) for kept, constants in _kept_for(bench)}
    return next((kept for kept, each in when.items() if each > when.get(path, each)), None)


def aiming_constants(given: Path | None, bench_json: str, devices: Mapping[str, str]) -> Known | None:
    """The constants to aim by: those named, else the newest of this bench that rest on measured spots.

    `devices`: role -> model and serial; empty where nobody opened them. Raises `ForeignConstants` for named ones of
    other models, `StaleConstants` where the bench has changed since and none are named.
    """

    def chosen(path: Path, constants: BenchConstants, stale: Sequence[str]) -> bool:
        if not constants.aims:
            return False
        if stale:
            raise StaleConstants(
                f"{path}: bench {constants.bench} has changed since these constants were measured "
                f"({constants.measured_utc}): {'; '.join(stale)}. Scan with --constants none and calibrate again, or "
                f"take them all the same: --constants {path}"
            )
        return True

    return _known(given, bench_json, devices, chosen, logging.WARNING)


def correcting_constants(
    given: Path | None, bench_json: str, devices: Mapping[str, str], bin_width_s: float
) -> Known | None:
    """The constants to correct a scan's counts by: those named, else the newest of its bench for its bin width, that
    hold for the bench as it was in that scan; others are passed over and said. Raises `ForeignConstants`."""

    def chosen(path: Path, constants: BenchConstants, stale: Sequence[str]) -> bool:
        if abs(constants.bin_width_s / bin_width_s - 1) >= 1e-6:
            return False
        if stale:
            log.info("constants: %s passed over, the bench was another in this scan: %s", path, "; ".join(stale))
        return not stale

    return _known(given, bench_json, devices, chosen, logging.INFO)


def _known(
    given: Path | None,
    bench_json: str,
    devices: Mapping[str, str],
    chosen: Callable[[Path, BenchConstants, Sequence[str]], bool],
    level: int,
) -> Known | None:
    """Those named, whatever they are of; else the newest of the bench that are `chosen`, told why they are stale. Those
    of the other kind of bench, real or simulated, are passed over; the newest of them is said at `level`."""
    name, facts = facts_of(bench_json)
    if given == NONE:
        return None
    if given is not None:
        constants = load_checked(given)
        constants.refuse_other_models(devices)
        return Known(given, constants, tuple(constants.stale(devices, facts)))
    passed_over = ""
    for path, constants in _kept_for(name) if name else ():
        if why := _of_the_other_kind(constants, facts):
            passed_over = passed_over or (
                f"constants: {path} passed over: {why}. `nlos calibrate` with a scan of this bench measures its own; "
                f"--constants {path} takes these all the same"
            )
        elif chosen(path, constants, constants.stale(devices, facts)):
            return Known(path, constants)
    if passed_over:
        log.log(level, passed_over)
    return None


def _of_the_other_kind(constants: BenchConstants, facts: Facts) -> str:
    """A rehearsal's constants tell nothing of the real bench of that name, nor those of a real one of a rehearsal."""
    then, now = constants.bench_facts.get(INSTRUMENTS), facts.get(INSTRUMENTS)
    if now is None or then == now:
        return ""
    if then is None:
        return "it does not say whether it is of a simulated bench, and this one is real" if now == REAL else ""
    return f"it was measured on a {then} bench of this name, and this one is {now}"


def overrides(constants: BenchConstants, drawn: Aiming) -> list[str]:
    """Where the measured geometry is another than the bench file's, with both values."""
    measured = constants.geometry
    if measured is None:
        return []
    usual = ScannerGeometry(1.0)
    found = []
    for each in fields(ScannerGeometry):
        value, file_value = getattr(measured, each.name), getattr(drawn, each.name, getattr(usual, each.name))
        if abs(value - file_value) > 5e-5:
            if each.name.endswith("_rad"):
                name = f"{each.name.removesuffix('_rad')}_deg"
                found.append(f"{name} {degrees(value):.4f} deg (file {degrees(file_value):g})")
            else:
                unit = " m" if each.name.endswith("_m") else ""
                found.append(f"{each.name} {value:.4f}{unit} (file {file_value:g})")
    return found

"""`nlos calibrate --first-light`: delay, response, rates and a time window, before there is a scan."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.digits import value_and_error
from nlos.cli.agreeing import somebody_is_there
from nlos.cli.bench_files import check_bench_output, write_bench_file
from nlos.cli.benches import load_bench, opened
from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal
from nlos.doctor.area import area_of
from nlos.doctor.hands import light_is_agreed_to
from nlos.drivers.errors import LimitError
from nlos.first_light.bench_lines import with_block
from nlos.first_light.measuring import FirstLight, in_the_dark, in_the_light

if TYPE_CHECKING:
    from nlos.drivers.bench import Bench
    from nlos.drivers.bench_settings import BenchSettings, GeometrySettings
    from nlos.first_light.measuring import Rate


def first_light(bench: str | None, light: bool, output: Path | None, overwrite: bool) -> None:
    """Measures, says what was found, and writes the bench file with its `first_light` block to `output`."""
    check_bench_output(output, overwrite, "first light writes")
    table = load_bench(bench)
    if table.settings.safety.dry_run:
        raise UsageError(f"{table.path}: safety.dry_run is set: no light, no first light")
    with opened(table) as open_bench:
        closed, dark = in_the_dark(open_bench)
        _agree(open_bench, light)
        found = in_the_light(open_bench, closed, dark)
        counter = open_bench.counter.identity.name
    _say_place(table.settings.geometry)
    _tell(found)
    lines = _block(found, table.settings, counter)
    terminal.result("\nthe bench file's lines:\n" + "\n".join(lines))
    terminal.result(f"\na scan file's line:\n{_histogram_line(found)}")
    write_bench_file(with_block(table.text, "first_light", lines), table, output, overwrite)


def _agree(bench: "Bench", light: bool) -> None:
    """Light on a real bench is agreed to in words. Raises `LimitError` where nobody does."""
    if light or bench.simulated is not None:
        return
    if not (somebody_is_there() and light_is_agreed_to(str(area_of(bench)))):
        raise LimitError("shutter", "stays closed: no one agreed to light.", "Use --light when it is safe.")


def _say_place(geometry: "GeometrySettings") -> None:
    """What the delay rests on: constants play no part in it."""
    terminal.result(
        f"place      by the bench file: wall_distance_m {geometry.wall_distance_m:g}, scanner_x_m "
        f"{geometry.scanner_x_m:g}, scanner_y_m {geometry.scanner_y_m:g}"
    )


def _tell(found: "FirstLight") -> None:
    plus = "" if found.fwhm_s is None else f", {found.fwhm_s * 1e12:.0f} ps wide (FWHM)"
    terminal.result(
        f"delay      {found.delay_s * 1e9:+.4f} +- {found.delay_error_s * 1e9:.4f} ns beyond the light's way, for this "
        f"place (each millimetre of distance is 6.7 ps); the same within {found.spread_s * 1e12:.0f} ps at "
        f"{len(found.places)} places{plus}",
        delay_ns=found.delay_s * 1e9, delay_error_ns=found.delay_error_s * 1e9, spread_ns=found.spread_s * 1e9,
        response_fwhm_ps=None if found.fwhm_s is None else found.fwhm_s * 1e12,
    )  # fmt: skip
    terminal.result(f"direct     {found.direct} counts/s from the middle",
                    direct_cps=found.direct.cps)  # fmt: skip
    if found.closed is None:
        covered = (
            "nobody covered the detector" if found.dark is None else f"{found.dark} counts/s with the detector covered"
        )
        terminal.result(
            f"background not known: this bench has no shutter that could keep the laser off; {covered}",
            closed_cps=None, dark_cps=None if found.dark is None else found.dark.cps, room_cps=None,
        )  # fmt: skip
    elif found.dark is None or found.room is None:
        terminal.result(
            f"background {found.closed} counts/s with the shutter closed: dark "
            "counts and room light together; nobody covered the detector to tell them apart",
            closed_cps=found.closed.cps, dark_cps=None, room_cps=None,
        )  # fmt: skip
    else:
        terminal.result(
            f"dark       {found.dark} counts/s with the detector covered",
            closed_cps=found.closed.cps, dark_cps=found.dark.cps,
        )  # fmt: skip
        terminal.result(
            f"room       {found.room} counts/s of light that is not the laser's",
            room_cps=found.room.cps,
        )  # fmt: skip
        if found.dark.cps == 0:
            terminal.log("warning: not one dark count: a very quiet detector; a dead one would show no direct light")
    for warning in found.warnings:
        terminal.log(f"warning: {warning}")
    terminal.document["warnings"] = list(found.warnings)


def _block(found: "FirstLight", bench: "BenchSettings", counter: str) -> list[str]:
    values = [
        (
            "delay_ns",
            f"{found.delay_s * 1e9:.4f}",
            f"+- {found.delay_error_s * 1e9:.4f}, and 6.7 ps a mm of wall_distance_m",
        ),
        ("response_fwhm_ps", None if found.fwhm_s is None else f"{found.fwhm_s * 1e12:.0f}.0", "direct peak"),
        ("direct_cps", *_rounded(found.direct, "from the middle of the area")),
        ("dark_cps", *_rounded(found.dark, "detector covered")),
        ("room_cps", *_rounded(found.room, "shutter closed, less dark")),
        ("bench", json.dumps(bench.name), "these are its values: another bench has others"),
        ("simulated", str(bench.simulated).lower(), ""),
        ("counter", json.dumps(counter), ""),
    ]
    shown = [(f"  {key}: {value}", why) for key, value, why in values if value is not None]
    head = f"first_light:               # nlos calibrate --first-light, {datetime.now(UTC):%Y-%m-%d}"
    return [head, *(f"{line:<27}# {why}" if why else line for line, why in shown)]


def _rounded(rate: "Rate | None", what: str) -> tuple[str | None, str]:
    if rate is None:
        return None, what
    value, error = value_and_error(rate.cps, rate.error_cps)
    return f"{max(float(value), 0.0):.1f}", f"+- {error}, {what}"


def _histogram_line(found: "FirstLight") -> str:
    axis = found.window
    width_ps, offset_ns = axis.bin_width_s * 1e12, axis.offset_s * 1e9
    terminal.document["histogram"] = {"bins": axis.bins, "bin_width_ps": width_ps, "offset_ns": offset_ns}
    return f"histogram: {{bins: {axis.bins}, bin_width_ps: {width_ps:g}, offset_ns: {offset_ns:g}}}"

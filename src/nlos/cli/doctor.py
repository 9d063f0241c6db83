"""`nlos doctor`: examines software, disk and bench, one line each, and ends with a small scan."""

import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.benches import load_bench, opened
from nlos.cli.doctor_checks import BENCH_CHECKS, Finding, absent, disk, levels, small_scan, software
from nlos.cli.exit_codes import ExitCode
from nlos.cli.terminal import terminal


def doctor(
    bench: Annotated[str | None, typer.Option(metavar="BENCH", help="Default: the simulated bench.")] = None,
    light: Annotated[
        bool, typer.Option("--light", help="Allow a real bench to open its shutter for 16 points.")
    ] = False,
    clear_trip: Annotated[
        str | None,
        typer.Option(metavar="WHO", help="Clear a latched trip; give the name of the person who found its cause."),
    ] = None,
) -> int:
    """PASS, WARN or FAIL for everything that a scan needs; exits with 3 after a FAIL.

    The mirror moves a little around its centre with the shutter closed. A real bench opens its shutter only where
    --light is said.
    """
    from nlos.drivers.errors import DeviceError

    findings: list[Finding] = []
    try:
        for finding in _examine(bench, light, clear_trip):
            findings.append(finding)
            terminal.result(f"{finding.verdict}  {finding.what:<15}{finding.said}")
            if finding.remedy:
                terminal.result(f"      {'':<15}{finding.remedy}")
    except DeviceError as error:
        findings.append(Finding("FAIL", error.device, error.what, error.remedy))
        terminal.result(f"FAIL  {error.device:<15}{error.what} {error.remedy}".rstrip())
    verdicts = [finding.verdict for finding in findings]
    counted = {verdict: verdicts.count(verdict) for verdict in ("PASS", "WARN", "FAIL")}
    terminal.result(", ".join(f"{count} {verdict}" for verdict, count in counted.items()), **counted)
    terminal.document["findings"] = [asdict(finding) for finding in findings]
    return ExitCode.DEVICE if counted["FAIL"] else ExitCode.DONE


def _examine(word: str | None, light: bool, clear_trip: str | None) -> Iterator[Finding]:
    from nlos.drivers.dark import make_dark
    from nlos.drivers.errors import DeviceError

    table = load_bench(word)
    yield from software()
    yield from disk(Path())
    yield from levels(table.settings)
    if missing := list(absent(table.settings)):
        if table.settings.shutter.model != "none":
            with suppress(DeviceError):  # what can be closed is closed; what is missing is said below
                make_dark(table.settings)
        yield from missing
        return
    with opened(table) as bench:
        if clear_trip is not None:
            bench.shutter.clear_trip(clear_trip)
            yield Finding("PASS", "shutter", f"trip cleared in the name of {clear_trip}")
        for check in BENCH_CHECKS:
            yield from check(bench)
        if not (table.settings.simulated or light):
            yield Finding("WARN", "scan", "not done: it opens the shutter", "Say --light when it is safe to.")
            return
        with tempfile.TemporaryDirectory() as folder:
            yield from small_scan(bench, Path(folder))

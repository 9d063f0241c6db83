"""`nlos doctor`: examines software, disk and bench, one line each, and ends with a small scan."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.cli.benches import load_bench
from nlos.cli.exit_codes import ExitCode
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.doctor.findings import Finding
    from nlos.drivers.bench import Bench


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
    """PASS, WARN or FAIL for everything that a scan needs, SKIP for what cannot be examined; exits with 3 after a FAIL.

    The mirror moves a little, where the bench allows it, with the shutter closed. A real bench opens its shutter
    only where --light is said.
    """
    from nlos.doctor.examination import examine

    table = load_bench(bench)
    return _said(examine(table, light or table.settings.simulated, clear_trip, _nothing_more))


def _nothing_more(bench: "Bench") -> "Iterator[Finding]":
    return iter(())


def _said(findings: "Iterator[Finding]") -> int:
    """Each line as it is found, then how many of each kind."""
    all_of_them = []
    for finding in findings:
        all_of_them.append(finding)
        terminal.result(f"{finding.verdict}  {finding.what:<15}{finding.said}")
        if finding.remedy:
            terminal.result(f"      {'':<15}{finding.remedy}")
    verdicts = [finding.verdict for finding in all_of_them]
    counted = {verdict: verdicts.count(verdict) for verdict in ("PASS", "WARN", "FAIL", "SKIP")}
    shown = (f"{count} {verdict}" for verdict, count in counted.items() if count or verdict != "SKIP")
    terminal.result(", ".join(shown), **counted)
    terminal.document["findings"] = [asdict(finding) for finding in all_of_them]
    return ExitCode.DEVICE if counted["FAIL"] else ExitCode.DONE

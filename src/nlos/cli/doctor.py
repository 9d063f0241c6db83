"""`nlos doctor`: examines software, disk and bench, one line each; thoroughly on the first day and after new cables."""

import re
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.cli.agreeing import agrees, somebody_is_there
from nlos.cli.benches import load_bench
from nlos.cli.exit_codes import ExitCode, UsageError
from nlos.cli.named_files import BenchWord
from nlos.cli.targets import check_place, page_target
from nlos.cli.terminal import terminal
from nlos.doctor.advice import in_order
from nlos.doctor.area import area_of
from nlos.doctor.examination import Visit, examine
from nlos.doctor.hands import light_is_agreed_to
from nlos.doctor.page import write_page

if TYPE_CHECKING:
    from nlos.doctor.findings import Finding
    from nlos.drivers.bench import Bench


def doctor(
    bench: BenchWord = None,
    light: Annotated[
        bool, typer.Option("--light", help="Agree that the shutter opens; on a terminal, --thorough asks for it.")
    ] = False,
    move: Annotated[
        bool, typer.Option("--move", help="Agree that the mirror moves, in the dark; asked for on a terminal.")
    ] = False,
    thorough: Annotated[
        bool, typer.Option("--thorough", help="The first day's examination, with a page that holds its results.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PAGE.html", help="Where --thorough writes its page.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing page.")] = False,
    clear_trip: Annotated[
        str | None,
        typer.Option(metavar="WHO", help="Clear a latched trip, in the name of the person who found its cause."),
    ] = None,
) -> int:
    """PASS, WARN or FAIL for everything that a scan needs, SKIP for what cannot be examined; exits with 3 after a FAIL.

    The mirror moves a little, where the bench allows it, with the shutter closed; a real one only where that is agreed
    to, by a word typed or --move. A real bench opens its shutter only where --light is said. --thorough: in the dark
    every corner, markers, dark counts and timing linearity; then, agreed to in words, with light: rates, the beam at
    the corners, settling, trip, watchdog, interlock and a pulled cable. A person is asked for a lamp, the interlock and
    the cable.
    """
    if output is not None and not thorough:
        raise UsageError("-o names the page of a thorough examination. Use --thorough as well.")
    table = load_bench(bench)
    target = None
    if thorough:
        name = re.sub(r"[^A-Za-z0-9]+", "-", table.settings.name)[:60]
        target = page_target(output or Path(f"doctor-{name}-{datetime.now(UTC):%Y%m%d-%H%M%S}.html"))
        check_place(target, overwrite)
    opened_it = False

    def agreed(bench: "Bench") -> bool:
        nonlocal opened_it
        if light or (table.settings.simulated and not thorough):
            opened_it = True
        elif thorough and somebody_is_there():
            opened_it = light_is_agreed_to(str(area_of(bench)))
        return opened_it

    answers: dict[str, bool] = {}

    def may_move(why: str) -> bool:
        if table.settings.simulated or (move and not why):
            return not why
        if why not in answers:
            area = table.settings.geometry.allowed
            where = "its own limits (geometry.allowed is not set)" if area is None else str(area)
            answers[why] = agrees(f"{why} The mirror moves: as it is opened, then within {where}.".strip(), "move")
        return answers[why]

    visit = Visit(agreed, clear_trip, thorough, may_move=may_move)
    findings: list[Finding] = []
    code = _said(examine(table, visit), findings)
    if target is not None:
        target.parent.mkdir(exist_ok=True)
        write_page(target, table, findings, visit.met, opened_it, new=not overwrite)
        terminal.result(f"{target}", page=str(target))
    return code


def _said(findings: "Iterator[Finding]", all_of_them: "list[Finding]") -> int:
    """Each line as it is found, then how many of each kind, and what to do first."""
    for finding in findings:
        all_of_them.append(finding)
        terminal.result(f"{finding.verdict}  {finding.what:<15}{finding.said}")
        if finding.remedy:
            terminal.result(f"      {'':<15}{finding.remedy}")
    verdicts = [finding.verdict for finding in all_of_them]
    counted = {verdict: verdicts.count(verdict) for verdict in ("PASS", "WARN", "FAIL", "SKIP")}
    shown = (f"{count} {verdict}" for verdict, count in counted.items() if count or verdict != "SKIP")
    terminal.result(", ".join(shown), **counted)
    advice = in_order(all_of_them)
    if len(advice) > 1:
        terminal.result("what to do, in this order:")
        for number, line in enumerate(advice, 1):
            terminal.result(f"  {number}. {line}")
    terminal.document["advice"] = advice
    terminal.document["findings"] = [asdict(finding) for finding in all_of_them]
    return ExitCode.DEVICE if counted["FAIL"] else ExitCode.DONE

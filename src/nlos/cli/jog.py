"""`nlos jog`: the beam by arrow keys, with angles, place, rates and histogram in view, and marks for calibration."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from nlos.by_hand.jogging import Jog
from nlos.by_hand.marks import Marks
from nlos.by_hand.opening import in_hand
from nlos.by_hand.screen import screen_of_terminal
from nlos.by_hand.viewer import viewer
from nlos.cli.benches import load_bench
from nlos.cli.exit_codes import UsageError
from nlos.cli.named_files import BenchWord
from nlos.cli.point import ELSEWHERE, LIGHT, LIVE, PORT
from nlos.cli.terminal import terminal
from nlos.drivers.file_word import own_word


def jog(
    bench: BenchWord = None,
    light: Annotated[float | None, LIGHT] = None,
    marks: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Where marks go, for `nlos calibrate --spots`; added to where it exists. Default: spots-BENCH-DAY.csv",
        ),
    ] = None,
    live: Annotated[bool, LIVE] = False,
    port: Annotated[int, PORT] = 0,
    no_shutter: Annotated[bool, ELSEWHERE] = False,
) -> None:
    """Moves the beam by arrow keys. SPACE, held down, gives light; nothing else does but --light, and TAB
    for as long again. `m` marks a spot: its
    commanded angles, and where on the wall a ruler finds it, for `nlos calibrate --spots`."""
    table = load_bench(bench)
    table_of_spots = marks or Path(f"spots-{own_word(table.settings.name)}-{datetime.now(UTC):%Y%m%d}.csv")
    try:
        book = Marks(table_of_spots)
    except UnicodeDecodeError as error:
        raise UsageError(f"--marks {table_of_spots}: is no text, so no table of spots. Name another file.") from error
    with (
        viewer(live, port) as page,
        in_hand(table, {"mirror", "counter"}, light, no_shutter) as hand,
    ):
        if not hand.keys.there:
            raise UsageError("nlos jog needs a terminal; scripts use `nlos point`.")
        if hand.reach is None:
            raise hand.bench.absent["mirror"]
        jogging = Jog(hand, book, "" if page is None else page.url, light)
        if light is not None:
            hand.ask_for_light(light)
        with screen_of_terminal(hand.stops) as screen:
            while not jogging.ended:
                for key in hand.each_pressed():
                    jogging.press(key)
                screen.draw(jogging.lines(screen.size.columns, screen.size.lines))
                hand.update()
                if page is not None:
                    page.show(hand)
    if book.added:
        terminal.result(f"{book.path}: {book.count} spots", spots=str(book.path), marked=book.added)
        if book.unmeasured:
            terminal.log(f"{book.unmeasured} spots lack x_m and y_m: write in what the ruler says")
        named = "" if bench is None else f" --bench {bench}"
        terminal.log(f"nine or more tell the mirror's place: nlos calibrate --spots {book.path}{named}")

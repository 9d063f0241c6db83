"""`nlos point`: sends the beam to one place, with light only for as long as somebody asks for it."""

import math
import time
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.by_hand.opening import in_hand
from nlos.cli.benches import load_bench
from nlos.cli.contradictions import refuse_together
from nlos.cli.named_files import BenchWord
from nlos.cli.seconds import check_seconds
from nlos.cli.terminal import terminal
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles

if TYPE_CHECKING:
    from nlos.by_hand.hand import Hand

LIGHT = typer.Option(metavar="SECONDS", help="Light for this long, at the bench's alignment duty. Default: none.")
LIVE = typer.Option("--live", help="Show it on a read-only page in the browser as well; its address is printed.")
PORT = typer.Option(min=0, max=65535, help="The page's port; 0 picks a free one.")
ELSEWHERE = typer.Option("--no-shutter", help="Something else keeps the light off, or the beam safe.")


def _place(word: str) -> float:
    """A number; whatever begins with `-` comes here, also an option that does not exist."""
    try:
        return float(word)
    except ValueError:
        wrong = "no such option" if word.startswith("-") else "a number is expected"
        raise typer.BadParameter(f"{wrong}: {word}") from None


X_HELP = "Right of the wall's centre, metres; -0.2 is written as it is."


def point(
    x: Annotated[float, typer.Argument(metavar="X_M", parser=_place, help=X_HELP)],
    y: Annotated[float, typer.Argument(metavar="Y_M", parser=_place, help="Above it.")],
    bench: BenchWord = None,
    deg: Annotated[bool, typer.Option("--deg", help="X and Y are optical mirror angles in degrees.")] = False,
    light: Annotated[float | None, LIGHT] = None,
    hold: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Stay this long; without it, until a key is pressed.")
    ] = None,
    no_shutter: Annotated[bool, ELSEWHERE] = False,
) -> None:
    """Sends the beam to one place and stays there: until a key on a terminal, for --hold or --light seconds elsewhere.
    SPACE, held down, gives light as well. The mirror parks in the dark afterwards."""
    check_seconds("--hold", hold)
    longer = hold is not None and light is not None and light > hold
    refuse_together(
        "--hold", {f"--light {light or 0:g}": longer}, f"the light would outlast the stay of {hold or 0:g} s",
        "Use --light for as long as --hold at most.",
    )  # fmt: skip
    table = load_bench(bench)
    with in_hand(table, {"mirror"}, light, no_shutter) as hand:
        if hand.reach is None:
            raise hand.bench.absent["mirror"]
        if deg and not (math.isfinite(x) and math.isfinite(y)):
            raise LimitError("mirror", f"({x:g}, {y:g}) deg are not angles.", "Give x and y in degrees.")
        angles = MirrorAngles(math.radians(x), math.radians(y)) if deg else hand.reach.angles_of(x, y)
        hand.move_to(angles)
        x_m, y_m = hand.reach.place_of(angles)
        x_deg, y_deg = math.degrees(angles.x_rad), math.degrees(angles.y_rad)
        terminal.result(
            f"x {x_deg:+.4f} deg, y {y_deg:+.4f} deg (optical): ({x_m:+.4f}, {y_m:+.4f}) m on the wall",
            x_deg=x_deg, y_deg=y_deg, x_m=x_m, y_m=y_m, light_s=light or 0.0,
        )  # fmt: skip
        if light is not None:
            if hand.ask_for_light(light):
                terminal.log(f"light for {light:g} s")
        elif hand.keys.there and hold is None:
            by_key = f"No light: {hand.no_light} Any" if hand.no_light else "SPACE, held down: light. Any other"
            terminal.log(f"{by_key} key ends.")
        until_a_key = hold is None and light is None and hand.keys.there
        until_s = time.monotonic() + (math.inf if until_a_key else max(hold or 0.0, light or 0.0))
        _stay(hand, until_s)


def _stay(hand: "Hand", until_s: float) -> None:
    while not hand.pressed() and time.monotonic() < until_s:
        hand.update()
        for note in hand.notes:
            terminal.log(note)
        hand.notes.clear()

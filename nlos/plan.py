"""`nlos plan`: checks everything that a scan would, moves nothing, and says how long it will take."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.benches import load_bench, opened, twin
from nlos.terminal import terminal

if TYPE_CHECKING:
    from acquisition.plan import ScanPlan
    from acquisition.schemes import Choice


def plan(
    scan: Annotated[str, typer.Argument(metavar="SCAN", help="A YAML file, or the name of one in configs/scan.")],
    bench: Annotated[str | None, typer.Option(metavar="BENCH", help="Default: the simulated bench.")] = None,
    picture: Annotated[Path | None, typer.Option(metavar="F.png", help="The mirror's path, coloured by time.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Checks everything that `scan` would; duration with its parts, disk, photons to expect. Moves nothing: a real
    bench is not even opened, its simulated twin is asked."""
    from acquisition.outlook import aim_of, checked_angles
    from acquisition.scan_settings import ScanSettings
    from acquisition.schemes import choose
    from configs.load import load

    if picture is not None and picture.exists() and not overwrite:
        raise FileExistsError(f"{picture}: exists. Choose another name, or say --overwrite.")
    wanted, table = load("scan", scan, ScanSettings), load_bench(bench)
    planned = wanted.settings.plan()
    with opened(twin(table), quiet=True) as open_bench:
        angles = checked_angles(planned, open_bench, aim_of(open_bench))
        choice = choose(planned, open_bench, angles)
    _tell(planned, choice)
    if picture is not None:
        from nlos.figures import path_picture

        path_picture(planned, picture)
        terminal.result(f"{picture}: the path over the wall and the dwell of every point", picture=str(picture))


def _tell(plan: "ScanPlan", choice: "Choice") -> None:
    forecast = choice.forecast
    low_s, high_s = forecast.band_s
    disk = len(plan) * (plan.axis.bins * 4 + 64) + (1 << 20)
    parts = {"dwell_s": forecast.dwell_s, "settle_s": forecast.settle_s, "links_s": forecast.links_s,
             "upload_s": forecast.upload_s}  # fmt: skip
    wall = plan.wall
    terminal.result(f"points     {len(plan)} on {wall.width_m:g} x {wall.height_m:g} m", points=len(plan))
    terminal.result(f"scheme     {choice.scheme.value}: {choice.why}", scheme=choice.scheme.value, why=choice.why)
    terminal.result(
        f"duration   {forecast.total_s:.1f} s ({low_s:.1f} to {high_s:.1f} s): "
        + ", ".join(f"{name.removesuffix('_s')} {seconds:.1f} s" for name, seconds in parts.items()),
        duration_s=forecast.total_s, band_s=[low_s, high_s], parts=parts,
    )  # fmt: skip
    terminal.result(f"disk       {disk / 1e6:.1f} MB", disk_bytes=disk)

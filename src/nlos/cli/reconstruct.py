"""`nlos reconstruct`: from recordings, or any file that an importer reads, to pictures."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.importers.given import NOTHING
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.file_words import Axes, BinWidth, Depths, Rectified, WallSize, depths, given
from nlos.cli.method_settings import Weights, chosen_method, parse_settings
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal


def reconstruct(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings, plain HDF5 or imported formats.")],
    method: Annotated[str | None, typer.Option(help="Method name; see `nlos methods`. Default: lct.")] = None,
    weights: Weights = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR")] = Path("out"),
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="CONSTANTS.h5", help="Default: the newest in constants/ that fits the scan's devices."),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    html: Annotated[bool, typer.Option("--html", help="Also write a rotatable 3D view in one HTML file.")] = False,
    volume: Annotated[bool, typer.Option("--volume/--no-volume", help="Write the volume as well.")] = True,
    follow: Annotated[
        bool, typer.Option("--follow", help="Follow RUN (or what a .ticket serves) while it is being written.")
    ] = False,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask: tcp://HOST:PORT, or `local` for workers here.")
    ] = None,
    wall_size_m: WallSize = None,
    bin_width_ps: BinWidth = None,
    axes: Axes = None,
    rectified: Rectified = None,
    depth_m: Depths = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """From a recording, or any file that an importer reads, to a picture."""
    from nlos.chain import FIRST_STAGE, STAGES, reconstruct_file
    from nlos.recon.results import files_in

    method, chosen = chosen_method(weights, method, parse_settings(settings or []))
    _check(method, chosen, device)
    said, limits_m = given(wall_size_m, bin_width_ps, axes, rectified), depths(depth_m)
    if follow:
        if said != NOTHING or limits_m is not None:
            raise UsageError(
                "--follow: a scan that is being recorded says itself what it is; limit its picture afterwards"
            )
        _follow(runs, method, chosen, output, constants, device, volume, html, overwrite, scheduler)
        return
    folders = [output / run.stem if len(runs) > 1 else output for run in runs]
    if twice := {str(folder) for folder in folders if folders.count(folder) > 1}:
        raise UsageError(f"{', '.join(sorted(twice))}: two RUNs of one name. Reconstruct them one by one.")
    seconds: list[float] = []
    if scheduler is not None:
        from nlos.cli.archive import reconstruct_on

        seconds = reconstruct_on(
            scheduler, list(zip(runs, folders, strict=True)), method, chosen,
            constants=constants, device=device, html=html, volume=volume, overwrite=overwrite,
            given=said, depth_m=limits_m,
        )  # fmt: skip
    else:
        with Progress(len(runs) * STAGES, what="reconstruct", unit="stages") as progress:

            def stage(name: str) -> None:
                progress.at(name)
                progress.step(0 if name == FIRST_STAGE else 1)

            for run, folder in zip(runs, folders, strict=True):
                terminal.log(f"{run}: {method}")
                done = reconstruct_file(
                    run, method, chosen, folder, constants=constants, device=device, html=html, volume=volume,
                    overwrite=overwrite, given=said, depth_m=limits_m, stage=stage,
                )  # fmt: skip
                progress.step()
                seconds.append(done.seconds)
    for folder, took_s in zip(folders, seconds, strict=True):
        terminal.result(f"{folder}: {', '.join(files_in(folder))} ({method}, {took_s:.2f} s)")
    terminal.document["reconstructions"] = [
        {"run": str(run), "folder": str(folder), "seconds": took_s, "files": files_in(folder)}
        for run, folder, took_s in zip(runs, folders, seconds, strict=True)
    ]


def _check(method: str, settings: dict[str, object], device: str) -> None:
    """Refuses what no file can change, before any is read. Raises `InvalidSettings`."""
    from nlos.recon.device import check_device
    from nlos.recon.methods import parse_settings

    parse_settings(method, {key: value for key, value in settings.items() if key != "offsets"})
    check_device(device)


def _follow(
    runs: list[Path],
    method: str,
    settings: dict[str, object],
    output: Path,
    constants: Path | None,
    device: str,
    volume: bool,
    html: bool,
    overwrite: bool,
    scheduler: str | None,
) -> None:
    from nlos.live.following import follow_to_folder
    from nlos.recon.results import files_in

    if len(runs) != 1 or scheduler is not None:
        raise UsageError("--follow: follows one RUN, here")
    scan = follow_to_folder(
        runs[0], method, settings, output, constants=constants, device=device, volume=volume, html=html,
        overwrite=overwrite,
    )  # fmt: skip
    if scan.picture is None:
        raise Stopped(ExitCode.DATA, f"{runs[0]}: the scan ended without a picture. {scan.message}")
    done = scan.picture
    terminal.result(
        f"{output}: {scan.pictures} pictures, the last of {done.samples} points; {scan.skipped} skipped",
        folder=str(output), files=files_in(output), pictures=scan.pictures, skipped=scan.skipped, points=done.samples,
        change=done.change, error=done.error, seconds=done.reconstruction.seconds,
    )  # fmt: skip

"""`nlos reconstruct`: from recordings, or any file that an importer reads, to pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from nlos.chain import FIRST_STAGE, STAGES, reconstruct_file
from nlos.cli.archive import ended, files_of, folders_for, reconstruct_archive
from nlos.cli.archive_record import MADE
from nlos.cli.archive_task import Task
from nlos.cli.contradictions import refuse_together, refuse_without
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError, exit_code
from nlos.cli.file_words import Axes, BinWidth, Depths, Detector, Rectified, Response, WallSize, depths, given
from nlos.cli.film import reconstruct_film
from nlos.cli.method_settings import Weights, chosen_method, parse_settings
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal
from nlos.live.following import follow_to_folder
from nlos.live.own_process import prepare_process
from nlos.recipe import Recipe
from nlos.recon.device import check_device
from nlos.recon.parts import heard_by
from nlos.recon.results import NAMES, files_in, read_explained, read_made_of
from nlos.recon.volume import response_words
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder


def reconstruct(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="Recordings, other files, folders of them."),
    ],
    method: Annotated[
        str | None, typer.Option(help="Name (see `nlos methods`) or a file of your own, ./mine.py. Default: lct.")
    ] = None,
    weights: Weights = None,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR")] = Path("out"),
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="CONSTANTS.h5", help="Or none. Default: the newest of the scan's bench."),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    html: Annotated[bool, typer.Option("--html", help="Also write a rotatable 3D view in one HTML file.")] = False,
    volume: Annotated[bool, typer.Option("--volume/--no-volume", help="Write the volume as well.")] = True,
    follow: Annotated[
        bool, typer.Option("--follow", help="Follow RUN (or what a .ticket serves) while it is being written.")
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask: tcp://HOST:PORT; `local` or local:N for N processes here."),
    ] = None,
    wall_size_m: WallSize = None,
    bin_width_ps: BinWidth = None,
    axes: Axes = None,
    rectified: Rectified = None,
    detector: Detector = None,
    response: Response = "auto",
    depth_m: Depths = None,
    frame: Annotated[
        int | None,
        typer.Option(metavar="K", min=0, help="Of a scan of several frames, this one. Default: all, summed."),
    ] = None,
    film: Annotated[
        bool,
        typer.Option("--film", help="Every frame of RUN: film.npz, film.gif, and its track as a table."),
    ] = False,
    window: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="With --film: frames per picture. Default: all points once."),
    ] = None,
    memory: Annotated[
        bool,
        typer.Option("--memory", help="With --film: each picture from one frame and light of those around it."),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
    skip_existing: Annotated[
        bool, typer.Option("--skip-existing", help="Of several files, only those without results.")
    ] = False,
) -> None:
    """From a recording, or any file that an importer reads, to a picture."""
    asked = method is not None or weights is not None or bool(settings) or device != "cpu"
    method, chosen = chosen_method(weights, method, parse_settings(settings or []))
    said, limits_m = given(wall_size_m, bin_width_ps, axes, rectified, detector), depths(depth_m)
    of_files = {
        "--wall-size-m": wall_size_m is not None, "--bin-width-ps": bin_width_ps is not None,
        "--axes": axes is not None, "--rectified/--raw": rectified is not None, "--depth-m": limits_m is not None,
        "--detector": detector is not None, "--frame": frame is not None, "--scheduler": scheduler is not None,
    }  # fmt: skip
    offsets = "offsets" in chosen
    refuse_together(
        "--overwrite", {"--skip-existing": overwrite and skip_existing}, "results cannot be both replaced and kept",
        "Use one.",
    )  # fmt: skip
    refuse_together(
        "--set offsets=file", {"--rectified": offsets and bool(rectified)}, "time 0 is the wall, there is nothing to "
        "shift", "Use --raw, or leave the offsets out.",
    )  # fmt: skip
    refuse_without(
        "--window", window is not None and not film, "--film", "it says how many frames make a picture of it"
    )
    refuse_without("--memory", memory and not film, "--film", "it is of the frames of a film")
    refuse_together(
        "--memory", {"--window": memory and window is not None}, "each picture is of one frame's light and what "
        "others add", "Use one.",
    )  # fmt: skip
    if follow:
        refuse_together(
            "--follow", {"--film": film, **of_files, "--skip-existing": skip_existing, "--set offsets": offsets},
            "a scan that is being recorded describes itself, and is followed as one picture",
            "Use --follow alone, then reconstruct the finished recording with these.",
        )  # fmt: skip
    if film:
        refuse_together(
            "--film", {**of_files, "--html": html, "--no-volume": not volume, "--set offsets": offsets},
            "a film holds brightness and depth of every frame of a recording, as it is",
            "Leave these out, or reconstruct single frames with --frame K.",
        )  # fmt: skip
    recipe = Recipe(method, chosen, constants, response_wanted(response), device)
    if asked:
        _check(method, chosen, device)
    results = ResultsFolder(output, volume, html, limits_m, overwrite)
    if follow:
        _follow(runs, recipe, results)
        return
    if film:
        if len(runs) != 1 or runs[0].is_dir():
            raise UsageError("--film: makes a film of one RUN of `nlos scan`. Name one recording.")
        reconstruct_film(runs[0], recipe, results, window=window, memory=memory, skip_existing=skip_existing)
        return
    if len(runs) > 1 or runs[0].is_dir() or scheduler is not None:
        files = files_of(runs)
        tasks = [
            Task(str(file), file, recipe, replace(results, path=folder), said, frame)
            for file, folder in zip(files, folders_for(files, output), strict=True)
        ]
        _reconstruct_archive(tasks, output, scheduler, overwrite=overwrite, skip_existing=skip_existing)
        return
    if skip_existing and set(NAMES) <= set(files_in(output)):
        _refuse_other(output, method, frame)
        terminal.result(f"{output}: already exists, skipped", reconstructions=[])
        return
    terminal.log(f"{runs[0]}: {method}")
    with Progress(STAGES, what="reconstruct", unit="stages") as progress:
        total = STAGES

        def stage(name: str) -> None:
            progress.at(name)
            progress.step(0 if name == FIRST_STAGE else 1)

        def part(finished: int, parts: int, name: str) -> None:
            """A method may look several times: each time as many parts are still to come, or rounds within one."""
            nonlocal total
            if finished == 1:
                total += parts
                progress.going_to(total)
            progress.step()

        with heard_by(part, within=part):
            done = reconstruct_file(runs[0], recipe, results, given=said, frame=frame, stage=stage)
        progress.step()
    _say(method, [(str(runs[0]), output, done.seconds)])
    terminal.result(f"response: {response_words(done)}", response=response_words(done))
    if (to_m := done.intervals_to_m()) is not None:
        terminal.result(
            f"intervals: nearer than {to_m:.2f} m; farther away no light stands out of the noise",
            intervals_to_m=round(to_m, 4),
        )


def _refuse_other(folder: Path, method: str, frame: int | None) -> None:
    """Raises `FileExistsError` where the results in `folder` are not of this method and frame."""
    found = read_made_of(folder)
    if found != (method, frame):
        this, other = (name if of is None else f"{name}, frame {of}" for name, of in ((method, frame), found))
        raise FileExistsError(
            f"{folder}: --skip-existing: holds {other}, not {this}. Choose another folder, or use --overwrite."
        )


def _reconstruct_archive(
    tasks: Sequence[Task], output: Path, scheduler: str | None, *, overwrite: bool, skip_existing: bool
) -> None:
    """Several files, or a folder of them: each has an outcome of its own."""
    archived = reconstruct_archive(tasks, output, scheduler, overwrite=overwrite, skip_existing=skip_existing)
    told = archived.rows if terminal.verbosity > 0 else archived.now
    method = tasks[0].recipe.method
    _say(
        method,
        [(row["file"], output / row["folder"], row.get("method_seconds")) for row in told if row["outcome"] in MADE],
    )
    if stopped := ended(archived.rows, output):
        raise stopped


def _say(method: str, done: list[tuple[str, Path, float | None]]) -> None:
    """What was made: the file, where its results lie, and what it took."""
    told = [read_explained(folder) for _, folder, _ in done]
    for (_, folder, took_s), explained in zip(done, told, strict=True):
        took = "" if took_s is None else f", {took_s:.2f} s"
        terminal.result(f"{folder}: {', '.join(files_in(folder))} ({method}{took})")
        if explained.nothing:
            terminal.log(
                f"{folder}: WARNING: the picture {explained}: do not believe it. {explained.note}".rstrip(), -1
            )
        else:
            terminal.result(f"{folder}: {explained.figure}{explained.remark}")
            if explained.doubt:
                terminal.log(f"{folder}: WARNING: geometry in doubt: {explained.doubt}", -1)
    terminal.document["reconstructions"] = [
        {
            "run": run, "folder": str(folder), "seconds": took_s, "files": files_in(folder),
            "explained": explained.share, "explained_error": explained.error, "explained_note": explained.note,
            "explained_doubt": explained.doubt,
        }
        for (run, folder, took_s), explained in zip(done, told, strict=True)
    ]  # fmt: skip


def _check(method: str, settings: dict[str, object], device: str) -> None:
    """Refuses what no file can change, before any is read; it may load PyTorch. Raises `InvalidSettings`."""
    from nlos.recon.methods import parse_settings

    parse_settings(method, {key: value for key, value in settings.items() if key != "offsets"})
    check_device(device)


def _follow(runs: Sequence[Path], recipe: Recipe, results: ResultsFolder) -> None:
    if len(runs) != 1:
        raise UsageError("--follow: follows one RUN. Name one recording.")
    prepare_process()
    scan, output = follow_to_folder(runs[0], recipe, results), results.path
    code = ExitCode.DATA if scan.no_picture is None else exit_code(scan.no_picture)
    if scan.picture is None:
        raise Stopped(code, f"{runs[0]}: the scan ended without a picture. {scan.message}")
    done = scan.picture
    terminal.result(
        f"{output}: {scan.pictures} picture{'s' if scan.pictures != 1 else ''}, the last of {done.samples} points; "
        f"{scan.skipped} skipped",
        folder=str(output), files=files_in(output), pictures=scan.pictures, skipped=scan.skipped, points=done.samples,
        change=done.change, error=done.error, seconds=done.reconstruction.seconds,
    )  # fmt: skip
    if scan.no_picture is not None:
        raise Stopped(code, f"{output}: is not of the whole scan. {scan.message}")

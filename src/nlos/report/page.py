"""The report as a page: the best picture first, then how good it is, then everything else; one HTML file that loads
nothing from anywhere and prints."""

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.importers.unchanged import unchanged
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.calibration.errors import CalibrationError
from nlos.chain import constants_for
from nlos.cli.escaped import escaped
from nlos.cli.terminal import terminal
from nlos.loaded import load_scan
from nlos.recon.errors import NO_PICTURE, InvalidData
from nlos.recon.methods import find
from nlos.recon.reconstruct import reconstruct
from nlos.recon.seen import depth_span, visible_depth
from nlos.recon.view3d import view3d_page
from nlos.report.calibration_part import calibrated
from nlos.report.html import folded, picture
from nlos.report.in_words import in_words
from nlos.report.scan_part import ScanPart, scan_part
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.recon.volume import Reconstruction

_WITHOUT_SCRIPT = "<noscript><style>.still { display: block } iframe { display: none }</style></noscript>"
"""As on paper: nothing turns there, and a box would be empty."""


def write_report(runs: Sequence[Path], target: Path, methods: Sequence[str], *, new: bool = False) -> None:
    """Writes the report on `runs` to `target`, pictures by the first of `methods` foremost: of a scan that has no
    picture, why. Raises what reading raises, `InvalidSettings` for a method that does not exist, before anything is
    computed, and where it is `new` `FileExistsError`, where another has taken its place by the end."""
    knows_falloff = {method: "falloff" in find(method).Settings.model_fields for method in methods}
    sections, pictures = [], []
    for run in runs:
        made, section = _one(run, methods, knows_falloff, len(runs) > 1)
        pictures += made
        sections.append(section)
    name = " and ".join(escaped(run.name) for run in runs)
    style = (files("nlos.report") / "style.css").read_text(encoding="utf-8")
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        f'content="width=device-width"><title>{escape(name)}</title><style>{style}</style>{_WITHOUT_SCRIPT}</head><body>'
        f"{_side_by_side(pictures) if len(runs) > 1 else ''}{''.join(sections)}</body></html>"
    )
    with whole_file(target, new=new) as partial:
        partial.write_text(page, encoding="utf-8")


def _one(
    run: Path, methods: Sequence[str], knows_falloff: dict[str, bool], among_others: bool
) -> tuple[list["Reconstruction"], str]:
    """The pictures of one scan, and its part of the page."""
    with unchanged(run, grows=True):
        with open_checked(run) as recording:
            said = scan_part(recording)
        scan = load_scan(run)
    falloff = scan.falloff
    made: list[Reconstruction] = []
    quality = calibration = trouble = ""
    try:
        transient, quality, calibration = calibrated(scan, constants_for(scan, None))
        del scan  # methods need the memory
        for method in methods:
            terminal.log(f"{run}: {method}")
            settings: dict[str, object] = {}
            if falloff is not None and knows_falloff[method]:
                settings["falloff"] = falloff
            made.append(replace(reconstruct(transient, method, settings, elsewhere=True), scan=escaped(run.name)))
    except (CalibrationError, *NO_PICTURE) as error:
        terminal.log(f"{run}: no picture: {error}", -1)
        trouble = f"<h2>No picture</h2><p>{escape(str(error))}</p>"
    title = f"<h1>{escape(escaped(run.name))}</h1>"
    best, others = made[:1], made[1:]
    return made, "".join([
        title,
        *(_hero(result) for result in best if not among_others),
        trouble,
        _summary(said, quality, best),
        *(_turning(result) for result in best),
        *(_other(result) for result in others),
        calibration,
        said.rates,
        "<h2>The scan in full</h2>", said.about, said.settings, *(_settings(result) for result in made), said.events,
    ])  # fmt: skip


def _summary(said: ScanPart, quality: str, best: "Sequence[Reconstruction]") -> str:
    """How good it is, in one paragraph."""
    from nlos.recon.small_print import si

    words = [said.sentence, quality]
    for result in best:
        seen = visible_depth(result)
        span_m, part = depth_span([result]), float((seen == seen).mean())
        words.append(
            f"{result.method.upper()} sees surfaces between {span_m[0]:.2f} and {span_m[1]:.2f} m from the wall in "
            f"{100 * part:.0f} % of the picture, from {si(result.photons)}photons that came from around the corner."
            if part and span_m
            else f"{result.method.upper()} sees nothing: the front view is no brighter anywhere than its noise."
        )
        if result.explained is not None:
            words.append(
                f"The picture {result.explained.figure}{result.explained.remark}."
                if result.explained.share is not None
                else ""
            )
    label = "".join(_label(result) for result in best)
    return f'<p class="summary">{escape(" ".join(word for word in words if word))}</p>{label}{said.warnings}'


def _label(result: "Reconstruction") -> str:
    """A warning above everything where the picture explains nothing, or its geometry is doubtful."""
    if result.explained is not None and result.explained.doubt and not result.explained.nothing:
        return f'<p class="warning"><strong>Geometry in doubt:</strong> {escape(result.explained.doubt)}.</p>'
    if result.explained is None or not result.explained.nothing:
        return ""
    why = f" ({escape(result.explained.note)})" if result.explained.note else ""
    return (
        f'<p class="warning"><strong>This picture explains nothing of the light{why}.</strong> Do not believe it: '
        "check the wall's size, time zero and falloff, or measure longer.</p>"
    )


def _hero(result: "Reconstruction") -> str:
    from nlos.recon.pictures import summary_figure

    caption = f"{result.method.upper()}: front view and depth, looking towards the wall"
    drawn = picture(summary_figure(result), caption, in_words(result))
    return f'<div class="hero">{drawn}</div>'


def _side_by_side(pictures: "Sequence[Reconstruction]") -> str:
    """Every scan by every method on one colour scale; on demand the differences of neighbours: of methods of one scan,
    and of scans by one method."""
    from nlos.recon.gallery import difference_figure, gallery

    if not pictures:
        return ""
    titles = [_titled(result) for result in pictures]
    scans, methods = (list(dict.fromkeys(of)) for of in zip(*((r.made_from, r.method) for r in pictures), strict=True))
    rows = [[result for result in pictures if result.made_from == scan] for scan in scans]
    rows += [[result for result in pictures if result.method == method] for method in methods]
    seen = "; ".join(f"{title}: {in_words(result)}" for title, result in zip(titles, pictures, strict=True))
    drawn = picture(gallery(pictures, titles, 250), "front views and depths on one scale", seen)
    differences = []
    for one, other in (pair for row in rows for pair in pairwise(row)):
        this, that = _titled(one), _titled(other)
        try:
            differences.append(picture(difference_figure(one, other, (this, that)), f"{this} less {that}"))
        except InvalidData as error:
            differences.append(f"<p>{escape(str(error))}</p>")
    folded_away = f"<details><summary>Differences</summary>{''.join(differences)}</details>" if differences else ""
    return f'<h1>Side by side</h1><div class="hero">{drawn}</div>{folded_away}'


def _titled(result: "Reconstruction") -> str:
    return f"{result.made_from}, {result.method.upper()}"


def _turning(result: "Reconstruction") -> str:
    """The 3D view on a screen, a still picture of it on paper."""
    from nlos.report.still import still_figure

    source = escape(view3d_page(result))  # in a sandbox: its script turns points, and reaches nothing else of the page
    title = escape(f"3D view: {_titled(result)}")
    view = f'<iframe sandbox="allow-scripts allow-downloads" title="{title}" srcdoc="{source}"></iframe>'
    still = picture(still_figure(result), f"{result.method.upper()} in 3D; near is yellow", in_words(result))
    return f'<h2>In three dimensions</h2>{view}<div class="still">{still}</div>'


def _other(result: "Reconstruction") -> str:
    from nlos.recon.pictures import summary_figure

    name = result.method.upper()
    drawn = picture(summary_figure(result), f"{name}: front view and depth", in_words(result))
    return f"<h2>By {escape(name)}</h2>{drawn}"


def _settings(result: "Reconstruction") -> str:
    weights = "" if result.weights_sha256 is None else f"\nweights sha256: {result.weights_sha256}"
    settings = "\n".join(f"{key}: {value}" for key, value in result.settings.items() if value is not None)
    return folded(f"Settings of {result.method}, {result.seconds:.2f} s of computing", settings + weights)

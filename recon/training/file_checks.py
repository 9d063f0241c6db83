"""Whether scenes on disk can be learned from, and whether what is held out stays so: told before the first step."""

from collections.abc import Iterator
from pathlib import Path

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.isolated import one_reader
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.on_grid import on_grid
from nlos.recon.training.scenes import kind_names
from nlos.recon.training.scenes_on_disk import check_scene, fingerprint, kinds_of, read_scene, scene_files
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import WeightsError, find_weights, read_about

Problem = tuple[tuple[str | int, ...], str]
"""Where in the training file, and what is wrong with what, and what to do."""
SHOWN = 3
"""So many files of one kind of trouble are told with what is wrong; of the others the names alone."""


def problems_of_files(settings: TrainSettings) -> Iterator[Problem]:
    """Every file is read, in a child process first, and put on the grid; then those held out are compared with those
    learned from, by what they show. Folders of LFE's set are read when their turn comes."""
    known: dict[str, dict[Path, str]] = {}
    for block in ("data", "validation"):
        data: DatasetSettings = getattr(settings, block)
        if data.files is None:
            continue
        files = scene_files(data.files)
        if not files:
            yield (block, "files"), f"finds nothing (given {data.files!r}); `folder/*.h5` is a pattern"
        wrong: list[str] = []
        known[block] = {}
        with one_reader():
            for path in files:
                try:
                    check_scene(path)
                    known[block][path] = fingerprint(path)
                    _fits(path, data)
                except (OSError, ValueError, InvalidData) as error:
                    wrong.append(f"{path}: {str(error).removeprefix(f'{path}: ')}")
        yield from _each_by_name(block, wrong, "cannot be used either")
    yield from _kinds_held_out(settings, list(known.get("data", {})))
    held_out = known.get("validation", {})
    learned, before = {one: path for path, one in known.get("data", {}).items()}, set(_before(settings))
    yield from _each_by_name(
        "validation",
        [f"{path}: shows what {learned[one]} shows, which is learned from: hold out other scenes"
         for path, one in held_out.items() if one in learned],
        "are learned from, too",
    )  # fmt: skip
    yield from _each_by_name(
        "validation",
        [f"{path}: was learned from by {settings.start_from}, which this begins with"
         for path, one in held_out.items() if one in before],
        "were learned from, too",
    )  # fmt: skip


def _kinds_held_out(settings: TrainSettings, learned: list[Path]) -> Iterator[Problem]:
    """Made scenes of held-out kinds judge what nobody has seen: files that are learned from must show none of these."""
    held = settings.validation
    if not held.held_out or (held.files is not None and held.share == 1):
        return
    drawn = held.kinds or kind_names(held_out=True)
    shown = {path: kinds for path in learned if (kinds := [kind for kind in kinds_of(path) if kind in drawn])}
    others = ", ".join(kind for kind in drawn if not any(kind in kinds for kinds in shown.values()))
    instead = f"draw other kinds there (kinds: [{others}]), " if others else ""
    yield from _each_by_name(
        "data",
        [f"{path}: shows {kinds[0]}, a kind that `validation` draws as one never learned from: learn from other "
         f"scenes, {instead}or judge by files alone (files, share: 1.0)"
         for path, kinds in shown.items()],
        "show kinds that `validation` draws, too",
    )  # fmt: skip


def _each_by_name(block: str, wrong: list[str], others_are: str) -> Iterator[Problem]:
    """`PATH: what is wrong` of the first few, and the names of all others."""
    wrong = sorted(wrong)
    for words in wrong[:SHOWN]:
        yield (block, "files"), words
    if others := [words.split(": ", 1)[0] for words in wrong[SHOWN:]]:
        yield (block, "files"), f"{len(others)} more {others_are}: {', '.join(others)}"


def learned_from(settings: TrainSettings) -> list[str]:
    """Fingerprints of every scene on disk that these weights will have seen, those before them too."""
    files = [] if settings.data.files is None else scene_files(settings.data.files)
    return sorted({*(fingerprint(path) for path in files), *_before(settings)})


def _fits(path: Path, data: DatasetSettings) -> None:
    if path.is_dir():
        missing = [name for name in ("light-1-*.hdr", "confocal-0-*.hdr", "depth-0-*.hdr") if not any(path.glob(name))]
        if missing:
            raise ValueError(f"{', '.join(missing)} missing; a folder must be a scene of LFE's set")
        return
    scene = on_grid(read_scene(path), data.wall, data.time)
    if scene.retroreflective != data.retroreflective:
        raise ValueError(f"is {'' if scene.retroreflective else 'not '}retroreflective; `data` says the opposite")
    if not scene.light.any():
        raise ValueError(f"its light lies outside the {data.bins} bins of `data`")


def _before(settings: TrainSettings) -> list[str]:
    """What the weights that a training begins with have seen."""
    if settings.start_from is None:
        return []
    try:
        return list(read_about(find_weights(settings.start_from)).get("learned_from", ()))
    except WeightsError:
        return []  # named by another check

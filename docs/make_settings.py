"""Makes the pages of docs/settings/ from the classes that read the files: `python docs/make_settings.py`."""

from pathlib import Path

from pydantic import BaseModel

from nlos.acquisition.planning.patterns import PATTERNS
from nlos.catalogue import methods
from nlos.configs.describe import Setting, describe
from nlos.schemas import blocks, model_of

FOLDER = Path(__file__).parent / "settings"


def pages() -> dict[str, str]:
    """File name -> Markdown."""
    return {
        "methods.md": _methods(),
        "patterns.md": _patterns(),
        "scan.md": _file("scan", "Scan files", "What `nlos plan SCAN` and `nlos scan SCAN` read."),
        "bench.md": _file("bench", "Bench files", "What `--bench BENCH` reads."),
        "queue.md": _file("queue", "Queue files", "What `nlos queue FILE` reads."),
        "defaults.md": _file(
            "defaults", "Personal defaults", "`~/.config/nlos/defaults.yaml`: what applies to every scan of yours."
        ),
        "train.md": _file("train", "Training files", "What `nlos train CONFIG` reads."),
    }


def _methods() -> str:
    parts = ["# Methods\n", "Set these as `--set KEY=VALUE`, or as keywords of `nlos.reconstruct`.\n"]
    for method in methods().values():
        parts += [f"## {method.name}\n", f"{method.what}\n", _table(method.settings)]
    return "\n".join(parts)


def _patterns() -> str:
    parts = [
        "# Patterns\n",
        "`pattern: {kind: NAME, ...}` in a scan file; `pattern: NAME` where nothing else is set.\n",
    ]
    for name, pattern in sorted(PATTERNS.items()):
        settings = {key: setting for key, setting in describe(pattern).items() if key != "kind"}
        parts += [f"## {name}\n", f"{_first_paragraph(pattern)}\n"]
        parts += [_table(settings)] if settings else []
    return "\n".join(parts)


def _file(kind: str, title: str, what: str) -> str:
    top = model_of(kind)
    parts = [f"# {title}\n", f"{what} `nlos schema {kind}` prints the same as a JSON Schema, for editors.\n"]
    for block in sorted(blocks(top), key=lambda b: b is not top):
        if not block.model_fields or (kind == "scan" and block in PATTERNS.values()):
            continue
        name = "The file" if block is top else _heading(block)
        parts += [f"## {name}\n", f"{_first_paragraph(block)}\n", _table(describe(block))]
    return "\n".join(parts)


def _heading(block: type[BaseModel]) -> str:
    return f"{block.__name__.removesuffix('Settings')} ({block.__module__.removeprefix('nlos.').split('.')[0]})"


def _first_paragraph(block: type[BaseModel]) -> str:
    return " ".join((block.__doc__ or "").strip().split("\n\n")[0].split())


def _table(settings: dict[str, Setting]) -> str:
    rows = ["| key | type | default | what |", "|---|---|---|---|"]
    for setting in settings.values():
        unit = f"({setting.unit})" if setting.unit else ""
        kind = " ".join(part for part in (setting.type, unit, setting.range) if part)
        default = f"`{setting.default}`" if setting.default else "must be given"
        if setting.default.startswith("{"):
            default = "its own defaults"
        rows.append(f"| `{setting.name}` | {_cell(kind)} | {_cell(default)} | {_cell(setting.what)} |")
    return "\n".join(rows) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")

"""Reads a YAML file into its settings, or says where in the file what is wrong and what was probably meant."""

import difflib
import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from nlos.configs.kinds import Kind, called, not_text, of_another_kind
from nlos.configs.read_whole import read_whole
from nlos.configs.settings import ConfigError as ConfigError
from nlos.configs.settings import Settings

Model = TypeVar("Model", bound=Settings)
Place = tuple[str | int, ...]

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
MAX_NODES = 100_000
_PLAIN_TAGS = {f"tag:yaml.org,2002:{word}": word for word in ("null", "bool", "int", "float", "str", "map", "seq")}
_OWN_FOLDER = Path(__file__).parent
_OTHERWISE = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-9.]+)+)")
"""Numbers that YAML 1.1 takes for others: 010 is octal, 1:30 counts sixties."""


@dataclass(frozen=True)
class Loaded(Generic[Model]):
    """Settings, and the text that they were read from, for the record."""

    settings: Model
    path: Path
    text: str


def names(kind: Kind) -> list[str]:
    """Names of the files that come with the package, sorted."""
    return sorted(path.stem for path in (_OWN_FOLDER / kind).glob("*.yaml"))


def find(kind: Kind, word: str) -> Path:
    """The file that `word` means: a path, or a name in `configs/<kind>`. Raises `ConfigError`."""
    path = Path(word)
    if path.is_file():
        return path
    own = _OWN_FOLDER / kind / f"{word}.yaml"
    if path.name == word and path.suffix == "" and own.is_file():
        return own
    known, what = names(kind), called(kind) if kind == "train" else kind
    if path.exists():
        raise ConfigError(f"{word}: is {'a folder' if path.is_dir() else 'a pipe or device'}, not a {what} file.")
    raise ConfigError(
        f"{word}: no such file, and no {what} of that name.{_did_you_mean(word, known)} Known: {', '.join(known)}"
    )


def load(kind: Kind, word: str, model: type[Model]) -> Loaded[Model]:
    """The settings in the file that `word` means. Raises `ConfigError`, and `ConfigNotRead` where its disk fails."""
    path = find(kind, word)
    raw = read_whole(path)
    if foreign := not_text(kind, raw):
        raise ConfigError(f"{path}: {foreign}")
    if len(raw) > MAX_BYTES:
        raise ConfigError(f"{path}: is {len(raw)} bytes long; settings of more than {MAX_BYTES} bytes are not read")
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise ConfigError(
            f"{path}:{line}:{column}: byte 0x{raw[error.start]:02x} is not UTF-8 text. Save the file as UTF-8."
        ) from error
    try:
        return Loaded(parse(text, str(path), model), path, text)
    except ConfigError as error:
        data = _read(text, str(path))[0]  # raises again what keeps it from being read at all
        if foreign := of_another_kind(kind, data if isinstance(data, dict) else ()):
            raise ConfigError(f"{path}:1:1: {foreign}") from error
        raise


def parse(text: str, name: str, model: type[Model]) -> Model:
    """The settings in `text`; `name` stands for the file in messages. Raises `ConfigError`."""
    data, places = _read(text, name)
    if not isinstance(data, dict):
        raise ConfigError(f"{name}:1:1: the file must hold `key: value` lines (found {_shown(data)})")
    try:
        # JSON mode is strict about types and still reads lists as tuples and words as enumerations.
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        told = [dict(item) for item in error.errors(include_url=False)]
        lines = [_explain(item, data, places, name, model) for item in told if not _only_follows(item, told)]
        raise ConfigError("\n".join(dict.fromkeys(lines))) from error


def _only_follows(item: dict[str, Any], told: list[dict[str, Any]]) -> bool:
    """Whether a list is called too short because what is wrong within it was not counted."""
    within = [other for other in told if len(other["loc"]) > len(item["loc"])]
    return item["type"] == "too_short" and any(other["loc"][: len(item["loc"])] == item["loc"] for other in within)


def where(loaded: Loaded[Model], place: Place) -> str:
    """`file:line:column: key` of a place in a file that was read; the nearest block around a key that is not in it."""
    _, marks = _read(loaded.text, str(loaded.path))
    known = next(place[:size] for size in range(len(place), -1, -1) if place[:size] in marks)
    return f"{loaded.path}:{marks[known].line + 1}:{marks[known].column + 1}: {_dotted(place)}"


def _read(text: str, name: str) -> tuple[Any, dict[Place, yaml.Mark]]:
    try:
        _check_depth(text, name)
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        at = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        tab = " Lines are indented by spaces." if "'\\t'" in str(error.problem) else ""
        raise ConfigError(f"{name}:{at}: not valid YAML: {error.problem or error.context}.{tab}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}:1:1: not valid YAML: {' '.join(str(error).split())}") from error
    if node is None:
        raise ConfigError(f"{name}:1:1: the file is empty")
    places: dict[Place, yaml.Mark] = {}
    return _value(node, (), places, name), places


def _check_depth(text: str, name: str) -> None:
    """Refuses deep nesting while it is still a flat stream of events: composing it would exhaust the stack."""
    depth = 0
    for count, event in enumerate(yaml.parse(text, Loader=yaml.SafeLoader)):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH or count > 2 * MAX_NODES:
            at = f"{event.start_mark.line + 1}:{event.start_mark.column + 1}" if event.start_mark else "1:1"
            raise ConfigError(f"{name}:{at}: nested too deep, or too long, for settings")


def _value(node: yaml.Node, place: Place, places: dict[Place, yaml.Mark], name: str) -> Any:
    mark = node.start_mark
    at = f"{name}:{mark.line + 1}:{mark.column + 1}: {_dotted(place)}"
    places.setdefault(place, mark)
    if len(places) > MAX_NODES or len(place) > MAX_DEPTH:
        raise ConfigError(f"{at}: aliases unfold into too many values for settings")
    word = _PLAIN_TAGS.get(node.tag)
    if isinstance(node, yaml.MappingNode) and word == "map":
        return _mapping(node, place, places, name)
    if isinstance(node, yaml.SequenceNode) and word == "seq":
        return [_value(child, (*place, index), places, name) for index, child in enumerate(node.value)]
    if isinstance(node, yaml.ScalarNode):
        if node.tag == "tag:yaml.org,2002:timestamp":
            return node.value
        if word in ("null", "bool", "int", "float", "str"):
            try:
                value = yaml.SafeLoader("").construct_object(node)
            except (ValueError, yaml.YAMLError) as error:
                raise ConfigError(f"{at}: not a {word} ({node.value!r})") from error
            if word in ("int", "float") and _OTHERWISE.fullmatch(node.value):
                raise ConfigError(
                    f"{at}: YAML reads {node.value} as {value:g}; write the number as it is meant, or text in quotes"
                )
            if isinstance(value, int) and abs(value) >= 1 << 63:
                raise ConfigError(f"{at}: too large a number ({node.value[:40]!r})")
            return value
    raise ConfigError(f"{at}: YAML tags and merge keys are not read here ({node.tag})")


def _mapping(node: yaml.MappingNode, place: Place, places: dict[Place, yaml.Mark], name: str) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key_node, child in node.value:
        mark = key_node.start_mark
        at = f"{name}:{mark.line + 1}:{mark.column + 1}"
        if not isinstance(key_node, yaml.ScalarNode) or key_node.tag != "tag:yaml.org,2002:str":
            given = getattr(key_node, "value", "?")
            hint = " If it is the end of a number: decimals follow a dot." if str(given).isdigit() else ""
            raise ConfigError(f"{at}: keys must be plain words (given {given!r}).{hint}")
        key = str(key_node.value)
        if key in result:
            first = places[(*place, key)]
            raise ConfigError(f"{at}: {_dotted((*place, key))}: given twice (first in line {first.line + 1})")
        places[(*place, key)] = mark
        result[key] = _value(child, (*place, key), places, name)
    return result


def _explain(error: dict[str, Any], data: Any, places: dict[Place, yaml.Mark], name: str, model: type[Settings]) -> str:
    place = _place_in_file(error["loc"], data)
    mark = places.get(place) or places[()]
    key = _dotted(place)
    message = str(error["msg"])
    given = error.get("input")
    match error["type"]:
        case "extra_forbidden":
            hint = _did_you_mean(str(place[-1]), sorted(_keys_beside(model, error["loc"])))
            return f"{name}:{mark.line + 1}:{mark.column + 1}: {key}: no such key.{hint}"
        case "missing":
            missing = _dotted((*place, str(error["loc"][-1])))
            return f"{name}:{mark.line + 1}:{mark.column + 1}: {missing}: is missing"
        case "value_error":
            message = message.removeprefix("Value error, ")
        case "union_tag_invalid":
            # The message names the branch; the word that chose it is the key to fix.
            tag, known = str(error["ctx"]["tag"]), str(error["ctx"]["expected_tags"])
            place = (*place, str(error["ctx"]["discriminator"]).strip("'"))
            mark = places.get(place, mark)
            words = [word.strip("' ") for word in known.split(",")]
            hint = _did_you_mean(tag, words)
            if not hint and place[-1] == "model":
                hint = " One of another package is there once that is installed."
            message = f"must be one of {', '.join(words)} (given {tag!r}).{hint}"
            return f"{name}:{mark.line + 1}:{mark.column + 1}: {_dotted(place)}: {message}"
    hint = ""
    if isinstance(given, bool):
        meant = "yes, on and true" if given else "no, off and false"
        hint = f" YAML takes {meant} for {given}; a word of these letters is put in quotes."
    elif isinstance(given, str):
        if _is_number(given):
            hint = f" YAML reads {given} as text; write it with a dot and a signed exponent, as {_as_yaml(given)}."
            if isinstance(yaml.safe_load(given), int | float):
                hint = " It is in quotes; leave them out."
        elif re.fullmatch(r"[-+]?[0-9]+,[0-9]+", given):
            hint = f" Decimals follow a dot: {given.replace(',', '.')}."
        elif error["type"] in ("float_type", "int_type") and re.fullmatch(r"[-+]?[0-9.]+ *[a-zA-Zµ%]+", given):
            hint = " Write the number alone: its unit is the one in the key's name."
        elif "expected" in error.get("ctx", {}):
            hint = _did_you_mean(given, [word.strip("' ") for word in str(error["ctx"]["expected"]).split(" or ")])
    return f"{name}:{mark.line + 1}:{mark.column + 1}: {key}: {message} (given {_shown(given)}).{hint}"


def _place_in_file(loc: Place, data: Any) -> Place:
    """The part of pydantic's location that the file has: names of union branches and missing keys drop out."""
    place: list[str | int] = []
    for step in loc:
        if isinstance(data, dict):
            present = step in data
        else:
            present = isinstance(data, list) and isinstance(step, int) and step < len(data)
        if present:
            data = data[step]
            place.append(step)
    return tuple(place)


def _keys_beside(model: type[BaseModel], loc: Place) -> set[str]:
    """Keys allowed where the unknown one (the last of `loc`) is."""
    models: list[type[BaseModel]] = [model]
    for step in loc[:-1]:
        fields = [found.model_fields[step] for found in models if isinstance(step, str) and step in found.model_fields]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        elif chosen := [found for found in models if _is_called(found, step)]:
            models = chosen
    return {key for found in models for key in found.model_fields}


def _is_called(model: type[BaseModel], word: str | int) -> bool:
    """Whether `word` is what chooses this branch of a union."""
    return any(word in get_args(field.annotation) for field in model.model_fields.values())


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _did_you_mean(word: str, known: list[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f" Did you mean '{close[0]}'?" if close else ""


def _dotted(place: Place) -> str:
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    return text.lstrip(".") or "the file"


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _as_yaml(number: str) -> str:
    mantissa, _, exponent = number.lower().partition("e")
    mantissa = mantissa if "." in mantissa else mantissa + ".0"
    return f"{mantissa}e{int(exponent):+d}" if exponent else mantissa


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

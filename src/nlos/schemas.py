"""JSON Schemas of the YAML files, made from the settings that read them."""

from typing import Any, Literal

from pydantic import BaseModel

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.configs.describe import describe
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.run_defaults import RunDefaults
from nlos.series.settings import QueueSettings

Kind = Literal["scan", "bench", "queue", "defaults", "train"]


def schema_of(kind: Kind) -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a kind of file, with the meaning of every key."""
    model = model_of(kind)
    made: dict[str, Any] = model.model_json_schema(by_alias=True)
    made["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    made["title"] = f"nlos {kind} file"
    _explain(made, model)
    _in_the_standards_words(made, made)
    return made


def model_of(kind: str) -> type[BaseModel]:
    if kind == "scan":
        return ScanSettings
    if kind == "bench":
        return BenchSettings
    if kind == "queue":
        return QueueSettings
    if kind == "defaults":
        return RunDefaults
    from nlos.recon.training.train_settings import TrainSettings

    return TrainSettings


def _explain(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Adds what each key means, to the file's own keys and to those of every block in it."""
    named = {block.__name__: block for block in blocks(model)}
    for name, part in {model.__name__: schema, **schema.get("$defs", {})}.items():
        if name not in named:
            continue
        for key, setting in describe(named[name]).items():
            if setting.what and key in part.get("properties", {}):
                part["properties"][key]["description"] = setting.what


def _in_the_standards_words(part: Any, schema: dict[str, Any]) -> None:
    """`discriminator` is OpenAPI's and strict validators refuse it; what it says, that a block of several kinds names
    its kind, is said of each kind."""
    if isinstance(part, dict) and "oneOf" in part and "discriminator" in part:
        choice = part.pop("discriminator")
        for place in choice["mapping"].values():
            kind = schema["$defs"][place.removeprefix("#/$defs/")]
            kind["required"] = sorted({*kind.get("required", ()), choice["propertyName"]})
    for each in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        _in_the_standards_words(each, schema)


def blocks(model: type[BaseModel]) -> list[type[BaseModel]]:
    """The model and every model inside it."""
    found: list[type[BaseModel]] = []
    todo: list[Any] = [model]
    while todo:
        kind = todo.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            if kind not in found:
                found.append(kind)
                todo += [field.annotation for field in kind.model_fields.values()]
        else:
            todo += getattr(kind, "__args__", ())
    return found

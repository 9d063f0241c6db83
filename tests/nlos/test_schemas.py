"""`nlos schema` in the words of the standard: what comes with the package is valid by it, and mistakes are not."""

import copy
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from nlos.acquisition.planning.patterns import PATTERNS, Word
from nlos.configs.load import names
from nlos.schemas import Kind, schema_of

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
CONFIGS = Path(__file__).parents[2] / "configs"
KINDS: tuple[Kind, ...] = ("scan", "bench", "train")
WORDS = {
    "$defs", "$ref", "$schema", "additionalProperties", "anyOf", "const", "default", "description", "enum",
    "exclusiveMaximum", "exclusiveMinimum", "items", "maxItems", "maxLength", "maximum", "minItems", "minLength",
    "minimum", "oneOf", "pattern", "prefixItems", "properties", "propertyNames", "required", "title", "type",
}  # fmt: skip
"""Of JSON Schema, draft 2020-12. Strict validators (ajv, as it comes) refuse a schema with any other."""


def mistakes(kind: Kind, data: Any) -> list[str]:
    return [error.message for error in jsonschema.Draft202012Validator(schema_of(kind)).iter_errors(data)]


def shipped(kind: Kind, name: str) -> Any:
    return yaml.safe_load((CONFIGS / kind / f"{name}.yaml").read_text("utf-8"))


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in KINDS for name in names(kind)])
def test_shipped_files_are_valid(kind: Kind, name: str) -> None:
    assert mistakes(kind, shipped(kind, name)) == []


@pytest.mark.parametrize("kind", get_args(Kind))
def test_no_word_is_another_standards(kind: Kind) -> None:
    def check(part: Any) -> None:
        assert set(part) <= WORDS
        for word in ("properties", "$defs"):
            for each in part.get(word, {}).values():
                check(each)
        for each in (*part.get("anyOf", ()), *part.get("oneOf", ()), *part.get("prefixItems", ())):
            check(each)
        for word in ("items", "additionalProperties", "propertyNames"):
            if isinstance(part.get(word), dict):
                check(part[word])

    check(schema_of(kind))


@pytest.mark.parametrize(
    ("kind", "name", "block", "word"),
    [("scan", "sunflower", "pattern", "kind"), ("bench", "simulated", "mirror", "model")],
)
def test_a_block_of_several_kinds_names_its_kind(kind: Kind, name: str, block: str, word: str) -> None:
    data = shipped(kind, name)
    without = copy.deepcopy(data)
    del without[block][word]
    assert mistakes(kind, without)
    assert mistakes(kind, {**data, block: {**data[block], word: "nothing"}})


def test_a_pattern_that_needs_no_more_is_a_word() -> None:
    alone = [word for word, kind in PATTERNS.items() if not any(f.is_required() for f in kind.model_fields.values())]
    assert sorted(get_args(Word)) == sorted(alone)
    data = shipped("scan", "demo")
    for word in PATTERNS:
        assert bool(mistakes("scan", {**data, "pattern": word})) == (word not in alone)

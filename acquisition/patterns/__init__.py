"""The catalogue of patterns: one file each, one word each in a scan file."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from acquisition.patterns.raster import Raster
from acquisition.patterns.serpentine import Serpentine


def _spelled_out(value: Any) -> Any:
    """`pattern: raster` is short for `pattern: {kind: raster}`."""
    return {"kind": value} if isinstance(value, str) else value


Pattern = Annotated[
    Annotated[Raster | Serpentine, Field(discriminator="kind")],
    BeforeValidator(_spelled_out),
]

PATTERNS = {pattern.model_fields["kind"].default: pattern for pattern in (Raster, Serpentine)}
"""Word -> settings class. The first line of its docstring describes it."""

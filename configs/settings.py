"""The base of everything a YAML file may say: frozen, strict, and closed to unknown keys."""

from pydantic import BaseModel, ConfigDict


class ConfigError(ValueError):
    """A YAML file that may not be used. The message begins with `file:line:column` where that is known."""


class Settings(BaseModel):
    """A block of a YAML file. Unknown keys and wrong types are refused; nothing is coerced, clipped or guessed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, validate_default=True)

"""What belongs into the cable of a counter's input before a TTL pulse is sent through it."""

from collections.abc import Mapping
from math import inf

from annotated_types import Le
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from nlos.drivers.tcspc.block import CounterBlock

_TTL_MIDDLE_MV = 1500
"""Of a pulse of 3 V. An input whose levels end below it was not made for such pulses."""


def needs_attenuator(counter: type[CounterBlock], role: str) -> bool:
    """Whether a TTL pulse is more than this input (sync, detector) was made for."""
    return _most_mv(_block(counter, role)) < _TTL_MIDDLE_MV


def attenuator(block: BaseModel) -> str:
    """What has to be done before the cable of this input is plugged in; empty where nothing has."""
    fields = type(block).model_fields
    level_mv = getattr(block, "level_mv", None) or 0  # none: a level for NIM
    if getattr(block, "edge", "falling") != "rising" or level_mv <= 0:
        return ""
    if (most_mv := _most_mv(fields)) >= _TTL_MIDDLE_MV:
        return ""
    return (
        f"TTL is 3 V or more, the levels of this input end at {most_mv / 1000:g} V: put an attenuator to below "
        f"{most_mv / 1000:g} V into its cable before it is plugged in."
    )


def _block(counter: type[CounterBlock], role: str) -> Mapping[str, FieldInfo]:
    return getattr(counter.model_fields[role].annotation, "model_fields", {})


def _most_mv(fields: Mapping[str, FieldInfo]) -> float:
    """Without a limit where the model of another package states none."""
    limits = fields["level_mv"].metadata if "level_mv" in fields else ()
    return next((float(str(each.le)) for each in limits if isinstance(each, Le)), inf)

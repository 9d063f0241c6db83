"""What settings pages and `nlos methods` say of a key."""

from nlos.configs.describe import describe, docstring
from nlos.configs.settings import Settings


class Undocumented(Settings):
    """What `python -OO` drops."""

    __doc__ = None


class Block(Settings):
    """A block of a file."""

    needed: str
    """Without it the file is refused."""
    told: str = ""
    """May be left empty."""
    wait_ms: float = 2.0
    """How long."""


def test_a_key_that_may_be_left_empty_is_not_one_that_must_be_given() -> None:
    found = describe(Block)
    assert found["needed"].default == ""
    assert found["told"].default == '""'
    assert str(found["told"]) == 'told: text, default "". May be left empty.'
    assert str(found["wait_ms"]) == "wait_ms: number ms, default 2 ms. How long."


def test_a_block_says_what_it_is_where_python_drops_docstrings() -> None:
    assert docstring(Undocumented) == "What `python -OO` drops."
    assert docstring(Block) == "A block of a file."

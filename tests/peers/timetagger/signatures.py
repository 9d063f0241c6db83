"""Prints the parameters of the vendor's functions and methods, as JSON: `python signatures.py NAME.METHOD ...`.

Run by the interpreter that has the package. Overloaded ones name their parameters in their docstring alone.
"""

import inspect
import json
import re
import sys
from typing import Any

import Swabian.TimeTagger as package


def parameters(function: Any) -> list[str]:
    names = [each.name for each in inspect.signature(function).parameters.values()]
    if "args" in names:
        names = re.findall(r":param (\w+):", inspect.getdoc(function) or "")
    return [name for name in names if name != "self"]


def main() -> None:
    found = {}
    for path in sys.argv[1:]:
        item: Any = package
        for word in path.split("."):
            item = getattr(item, word, None)
        found[path] = None if item is None else parameters(item)
    print(json.dumps(found))


if __name__ == "__main__":
    main()

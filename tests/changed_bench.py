"""A bench file that ships with some of its values changed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from nlos.configs.load import find


def bench_file(folder: Path, changes: Mapping[str, Any], name: str = "simulated") -> str:
    """`folder`/bench.yaml of bench `name`, coarser in light, and with `changes`: dotted key -> value."""
    document = yaml.safe_load(find("bench", name).read_text("utf-8"))
    document["simulation"]["scene"]["surfel_m"] = 0.1
    for key, value in changes.items():
        place = document
        *above, last = key.split(".")
        for each in above:
            place = place.setdefault(each, {})
        place[last] = value
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return str(path)

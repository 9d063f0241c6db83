"""Shipped benches, every scheme and every kind of shutter, whose simulated table writes down what its light and beam do
and so bears witness from outside the program that is tested."""

from pathlib import Path

from nlos.configs.load import find

TTL = ("model: tcspc488\ngeometry", "model: triggerscope_ttl\ngeometry")
NO_SHUTTER = ("model: tcspc488\ngeometry", "model: none\ngeometry")
PIN = ("sim://triggerscope", "sim://triggerscope\n  shutter_pin: 16")
STEPPED = ("markers: true", "markers: false")
BENCHES = {
    "S1": ("optotune", ()),
    "S1, TTL shutter": ("simulated", (TTL, PIN, STEPPED)),
    "S2": ("simulated", ()),
    "S2, TTL shutter": ("simulated", (TTL, PIN)),
    "S2, no shutter": ("simulated", (NO_SHUTTER,)),
    "S3": ("multiharp", ()),
    "S3 of a tcspc488": ("simulated", (("usb: simulated\n", "usb: simulated\n  mode: t3\n"),)),
}
_CENTRE_RAD = 50e-6  # two steps of a DAC


def bench_file(folder: Path, name: str) -> Path:
    """A shipped bench, darker so that its photons cost little, with a witness."""
    file, changes = BENCHES[name]
    text = find("bench", file).read_text()
    for before, after in changes:
        assert text.count(before) == 1
        text = text.replace(before, after)
    text = text.replace("simulation:\n", f"simulation:\n  witness: {folder / 'witness.txt'}\n")
    path = folder / "bench.yaml"
    path.write_text(text.replace("  scene:\n", "  scene:\n    surfel_m: 0.05\n"))
    return path


def witnessed(folder: Path) -> list[str]:
    """What light and beam did, in order: `shutter open`, `shutter closed`, `beam to X Y`."""
    path = folder / "witness.txt"
    written = path.read_text().split("\n")[:-1] if path.exists() else []  # the last may be half written
    return [line.split(maxsplit=1)[1] for line in written]


def is_parked(line: str) -> bool:
    """Whether the beam is sent to the centre by what a line of the table's account says."""
    words = line.split()
    return words[0] == "beam" and all(abs(float(angle_rad)) < _CENTRE_RAD for angle_rad in words[2:])

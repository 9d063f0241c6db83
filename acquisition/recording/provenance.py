"""What a recording says about itself before the first photon: settings, software, devices, when."""

import json
import platform
import secrets
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from nlos.acquisition.recording.run_notes import NO_NOTES, RunNotes
from nlos.drivers.identity import DeviceIdentity

_PACKAGES = ("nlos", "numpy", "h5py", "pyserial", "pyusb", "pydantic")


@dataclass(frozen=True)
class Header:
    """The part of a recording that never changes. Texts are the files as given, `*_json` what they resolved to."""

    scan_text: str = ""
    scan_json: str = "{}"
    bench_text: str = ""
    bench_json: str = "{}"
    constants_json: str = "{}"
    """The measured constants that took part in the scan (aim, dead time, rates); `{}` where none did."""
    devices: Mapping[str, DeviceIdentity] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)
    git_hash: str = ""
    started_utc: str = ""
    warnings: tuple[str, ...] = ()
    identity: str = ""
    """Random, made with the file: copies of a recording have the same, two recordings never."""
    notes: RunNotes = NO_NOTES
    """What a person said about the run; empty in recordings of before there were notes."""

    def stamped(self) -> "Header":
        """The same header with software, git hash and time of now."""
        started_utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        return replace(self, software=software_versions(), git_hash=git_hash(), started_utc=started_utc)

    def named(self) -> "Header":
        """The same header with an identity, a new one where it has none."""
        return self if self.identity else replace(self, identity=secrets.token_hex(16))

    def texts(self) -> dict[str, str]:
        """Every field as text, keyed by its name: what is stored."""
        return {
            "identity": self.identity,  # first, so that it lies near the beginning of the file
            "scan_text": self.scan_text,
            "scan_json": self.scan_json,
            "bench_text": self.bench_text,
            "bench_json": self.bench_json,
            "constants_json": self.constants_json,
            "devices": json.dumps({role: asdict(identity) for role, identity in self.devices.items()}),
            "software": json.dumps(dict(self.software)),
            "git_hash": self.git_hash,
            "started_utc": self.started_utc,
            "warnings": json.dumps(list(self.warnings)),
            "run_json": self.notes.to_json(),
        }

    @classmethod
    def from_texts(cls, texts: Mapping[str, str]) -> "Header":
        """The inverse of `texts`. Raises `ValueError`, `KeyError` or `TypeError` where it was not made by `texts`."""
        plain = {key: str(texts[key]) for key in ("scan_text", "bench_text", "git_hash", "started_utc")}
        documents = {key: str(texts[key]) for key in ("scan_json", "bench_json", "constants_json")}
        return cls(
            **plain,
            **documents,
            devices={role: DeviceIdentity(**fields) for role, fields in json.loads(texts["devices"]).items()},
            software=dict(json.loads(texts["software"])),
            warnings=tuple(json.loads(texts["warnings"])),
            identity=str(texts.get("identity", "")),
            notes=RunNotes.from_json(texts.get("run_json", "{}")),
        )


def software_versions() -> dict[str, str]:
    """Versions of Python, the operating system and the packages that a scan runs on."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def git_hash() -> str:
    """The commit that this code was checked out from; empty outside a checkout."""
    return git_says("rev-parse", "HEAD")


def git_says(*words: str) -> str:
    """What git says of the folder that this code is in; empty outside a checkout, and where there is no git."""
    try:
        answer = subprocess.run(
            ["git", *words], cwd=Path(__file__).parent, capture_output=True, text=True, timeout=5.0, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return answer.stdout.strip() if answer.returncode == 0 else ""

"""A ticket: where a served recording is, and the keys without which nobody is answered."""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import zmq

from nlos.acquisition.errors import InvalidData

_KEY_LENGTH = 40  # a CurveZMQ key in Z85 (RFC 26/CURVEZMQ, RFC 32/Z85)


@dataclass(frozen=True)
class Ticket:
    """Whoever holds it may read the recording: it is kept like a password."""

    address: str
    server_public: str
    client_public: str
    client_secret: str

    def save(self, path: Path) -> None:
        """Writes a file that only its owner can read."""
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
            json.dump({"nlos": "ticket", **asdict(self)}, file, indent=1)

    @classmethod
    def load(cls, path: Path) -> "Ticket":
        """Raises `InvalidData` naming what is wrong, FileNotFoundError where nothing is there."""
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file. `nlos serve RUN` writes it while it serves.")
        try:
            raw = path.read_bytes()[:4096]
            stored = json.loads(raw)
        except (ValueError, RecursionError) as error:
            raise InvalidData(f"{path}: not a ticket ({error})") from error
        if not isinstance(stored, dict) or stored.pop("nlos", None) != "ticket":
            raise InvalidData(f"{path}: not a ticket. `nlos serve RUN` writes one.")
        fields = ("address", "server_public", "client_public", "client_secret")
        if set(stored) != set(fields) or not all(isinstance(stored[field], str) for field in fields):
            raise InvalidData(f"{path}: a ticket has {', '.join(fields)}")
        if not stored["address"].startswith("tcp://"):
            raise InvalidData(f"{path}: address {stored['address']!r} must begin with tcp://")
        if any(len(stored[field]) != _KEY_LENGTH for field in fields[1:]):
            raise InvalidData(f"{path}: its keys must be {_KEY_LENGTH} characters long")
        return cls(**stored)


def is_ticket(path: Path) -> bool:
    """Whether a file looks like a ticket; nothing is believed of what it says."""
    return path.suffix == ".ticket"


def new_keys() -> tuple[str, str]:
    """A CurveZMQ pair: public, secret."""
    public, secret = zmq.curve_keypair()
    return public.decode("ascii"), secret.decode("ascii")

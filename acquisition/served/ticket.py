"""A ticket: where a served recording is, which one, and the keys without which nobody is answered.

It ends with a checksum: a damaged one is refused here, and nobody is called at a damaged address.
"""

import hashlib
import json
import os
import secrets
import struct
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import zmq
from zmq.utils import z85

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.magic import check_is_file, read_bytes
from nlos.acquisition.served.address import check_endpoint

_KEY_LENGTH = 40  # a CurveZMQ key in Z85 (RFC 26/CURVEZMQ, RFC 32/Z85)
_CHECK = "check"
_KEYS = ("server_public", "client_public", "client_secret")


@dataclass(frozen=True)
class Ticket:
    """Whoever holds it may read the recording: it is kept like a password."""

    address: str
    server_public: str
    client_public: str
    client_secret: str
    recording: str
    """Which recording is served (its header's identity): a client takes no other."""

    def save(self, path: Path) -> None:
        """Puts a file in place that only its owner can read; an earlier ticket there is replaced.

        Raises `FileExistsError` where something else lies there, `StorageError` where the disk does not take it.
        """
        if os.path.lexists(path):
            try:
                Ticket.load(path)
            except (InvalidData, OSError) as error:
                raise FileExistsError(
                    f"{path}: exists and is not a ticket. Move it, or rename the recording."
                ) from error
        fresh = path.with_name(f"{path.name}.{secrets.token_hex(4)}.new")
        try:
            with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="utf-8") as file:
                json.dump({"nlos": "ticket", **asdict(self), _CHECK: self._check()}, file, indent=1)
            fresh.replace(path)
        except OSError as error:
            raise StorageError(
                f"{path}: cannot be written ({error.strerror}). It lies beside the recording: see that files can "
                "be made there, or serve a link to it that lies where they can."
            ) from error
        finally:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)

    def withdraw(self, path: Path) -> None:
        """Removes the file at `path` if it is this ticket: another server may have put its own there since."""
        try:
            if Ticket.load(path) == self:
                path.unlink(missing_ok=True)
        except (InvalidData, OSError):
            return

    @classmethod
    def load(cls, path: Path) -> "Ticket":
        """Raises `InvalidData` naming what is wrong, FileNotFoundError where nothing is there."""
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file. `nlos serve RUN` writes it while it serves.")
        check_is_file(path)
        try:
            with read_bytes(path) as file:
                stored = json.loads(file.read(4096))
        except (ValueError, RecursionError) as error:
            raise InvalidData(f"{path}: not a ticket ({error})") from error
        if not isinstance(stored, dict) or stored.pop("nlos", None) != "ticket":
            raise InvalidData(f"{path}: not a ticket. `nlos serve RUN` writes one.")
        check, names = stored.pop(_CHECK, None), [field.name for field in fields(cls)]
        if set(stored) != set(names) or not all(isinstance(stored[name], str) for name in names):
            raise InvalidData(f"{path}: a ticket has {', '.join(names)}. `nlos serve RUN` writes one.")
        try:
            check_endpoint(stored["address"])
            for key in _KEYS:
                if len(stored[key]) != _KEY_LENGTH or len(z85.decode(stored[key].encode("ascii"))) != 32:
                    raise ValueError(f"{key} is not a key of {_KEY_LENGTH} characters")
        except (ValueError, KeyError, struct.error) as error:
            raise InvalidData(f"{path}: address or keys are damaged ({error}). Copy the ticket again.") from error
        ticket = cls(**stored)
        if check != ticket._check():
            raise InvalidData(f"{path}: is damaged: its checksum is another's. Copy the ticket again.")
        return ticket

    def _check(self) -> str:
        return hashlib.sha256(json.dumps(asdict(self)).encode()).hexdigest()[:16]


def new_keys() -> tuple[str, str]:
    """A CurveZMQ pair: public, secret."""
    public, secret = zmq.curve_keypair()
    return public.decode("ascii"), secret.decode("ascii")

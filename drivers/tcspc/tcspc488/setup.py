"""The settings of a `tcspc488`: sent, remembered, and read back before every acquisition."""

from collections.abc import Mapping, Sequence

from nlos.drivers.errors import DeviceReset, WrongDevice
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.scpi import ErrorsReported, Scpi, encode_block
from nlos.drivers.tcspc.tcspc488.messages import decode_identity


class Setup:
    """What the instrument has been told, as header and value."""

    def __init__(self, device: str, scpi: Scpi, identity: DeviceIdentity) -> None:
        self._device = device
        self._scpi = scpi
        self._identity = identity
        self._told: dict[str, str] = {}

    def apply(self, commands: Mapping[str, str], lists: Mapping[str, Sequence[int]] | None = None) -> None:
        """Sends the commands, and lists as blocks of u32, in one message. Raises `ErrorsReported`."""
        units = [f"{header} {value}".encode() for header, value in commands.items()]
        for header, values in (lists or {}).items():
            payload = b"".join(value.to_bytes(4, "little") for value in values)
            units.append(header.encode() + b" " + encode_block(payload))
        self._scpi.command(*units)
        self._told |= commands

    def restore(self, lists: Mapping[str, Sequence[int]]) -> bool:
        """Reads everything back; what an instrument that restarted behind our back has lost is sent again, once.

        Whether that was needed. Raises `DeviceReset` where it does not help, `WrongDevice` where another answers.
        """
        if not self._wrong(lists):
            return False
        identity = decode_identity(self._device, self._scpi.query(b"*IDN?")[0])
        if identity != self._identity:
            raise WrongDevice(
                self._device, f"it now says it is a {identity}, and was a {self._identity}.", "Open the bench again."
            )
        self.apply(self._told, lists)
        if wrong := self._wrong(lists):
            raise DeviceReset(self._device, f"it does not keep its settings ({', '.join(wrong)}).", "Check its supply.")
        return True

    def _wrong(self, lists: Mapping[str, Sequence[int]]) -> list[str]:
        answers = self._scpi.query(*(f"{header}?".encode() for header in self._told))
        wrong = [header for header, answer in zip(self._told, answers, strict=True) if answer != self._told[header]]
        return wrong + [header for header, values in lists.items() if self._list(header, 4 * len(values)) != values]

    def _list(self, header: str, expected: int) -> Sequence[int]:
        answer = self._scpi.query_block(f"{header}?".encode(), expected=expected)
        if answer.error is not None:
            raise ErrorsReported(self._device, f"{header}?", (answer.error,))
        return answer.block.cast("I").tolist() if answer.block is not None and len(answer.block) % 4 == 0 else []

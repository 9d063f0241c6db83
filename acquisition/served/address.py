"""Where a server listens and a client calls: one address of one machine, checked before ZMQ sees it."""

import ipaddress
import re
import socket

_ENDPOINT = re.compile(
    r"tcp://(?:\[(?P<v6>[0-9A-Fa-f:.%a-z]+)\]|(?P<host>[A-Za-z0-9](?:[A-Za-z0-9._-]*)?)):(?P<port>\d{1,5})"
)


def listening_address(host: str) -> str:
    """The numeric address that `host` stands for, however it is written (`0` and `0x0` are 0.0.0.0).

    Raises `ValueError` for one that means every interface, and for what is no address.
    """
    try:
        found = {str(info[4][0]) for info in socket.getaddrinfo(host.strip("[]") or "0", None, type=socket.SOCK_STREAM)}
    except (OSError, UnicodeError) as error:
        raise ValueError(f"{host!r} is not an address of this machine ({error})") from error
    if any(_means_all(one) for one in found):
        raise ValueError(f"{host!r} is every interface; name the one address by which the other machine reaches this")
    return sorted(found, key=lambda one: (":" in one, one))[0]


def endpoint(address: str, port: int) -> str:
    """`tcp://ADDRESS:PORT`, an IPv6 address in brackets."""
    return f"tcp://[{address}]:{port}" if ":" in address else f"tcp://{address}:{port}"


def check_endpoint(text: str) -> None:
    """Raises `ValueError` for what cannot be called."""
    match = _ENDPOINT.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not tcp://HOST:PORT")
    if not 0 < int(match["port"]) < 65536:
        raise ValueError(f"{text!r}: a port is 1 to 65535")
    if _means_all(match["v6"] or match["host"]):
        raise ValueError(f"{text!r} is not an address of one machine")


def _means_all(host: str) -> bool:
    """Whether `host` is 0.0.0.0 or :: in any spelling; a name that needs a resolver is not looked up."""
    try:
        plain = str(ipaddress.IPv4Address(socket.inet_aton(host)))
    except (OSError, UnicodeError):
        plain = host
    try:
        found = ipaddress.ip_address(plain.partition("%")[0])
    except ValueError:
        return False
    mapped = found.ipv4_mapped if isinstance(found, ipaddress.IPv6Address) else None
    return found.is_unspecified or (mapped is not None and mapped.is_unspecified)

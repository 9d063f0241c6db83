"""Where a server listens and a client calls: one address of one machine, checked before ZMQ sees it."""

import ipaddress
import re
import socket

_ENDPOINT = re.compile(
    r"tcp://(?:\[(?P<v6>[0-9A-Fa-f:.%a-z]+)\]|(?P<host>[A-Za-z0-9](?:[A-Za-z0-9._-]*)?)):(?P<port>\d{1,5})"
)


def listening_address(host: str) -> str:
    """The numeric address that `host` stands for, however it is written (`0` and `0x0` are 0.0.0.0); of a name with
    addresses of both kinds the IPv4 one, as every network has it.

    Raises `ValueError` for one that means every interface, for what is no address, and for what another machine cannot
    call: a name that only means this machine, and an IPv6 address that needs the caller's own network card beside it.
    """
    plain = re.sub(r"^\[(.*:.*)\]$", r"\1", host)
    try:
        known = socket.getaddrinfo(plain or "0", None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise ValueError(f"{host!r} is not an address of this machine ({error})") from error
    found = {ipaddress.ip_address(str(info[4][0]).partition("%")[0]) for info in known}
    if any(_means_all(str(one)) for one in found):
        raise ValueError(f"{host!r} is every interface; name the one address by which the other machine reaches this")
    called = [one for one in found if not (one.version == 6 and one.is_link_local)]
    if not called:
        raise ValueError(
            f"{host!r} holds for one cable alone, and is called otherwise from its other end; name an address "
            "that the other machine can call as it is"
        )
    outside = [one for one in called if not one.is_loopback]
    best = min(outside or called, key=lambda one: (one.version, int(one)))
    if not outside and not _is_this_machine(plain):
        raise ValueError(
            f"{host!r} is {best} here, which no other machine reaches (/etc/hosts says so, as Debian "
            "writes it); name the address in the network, which `hostname -I` shows"
        )
    return str(best)


def _is_this_machine(host: str) -> bool:
    """Whether it says by itself that nobody else is meant."""
    return any(word in host.lower() for word in ("localhost", "loopback", ":")) or host[:1].isdigit()


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

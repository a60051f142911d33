"""The names and addresses under which other machines reach this one."""

import ipaddress
import re
import socket
import struct
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from mrnav_server.core.errors import ConfigError

Address = str | ipaddress.IPv4Address | ipaddress.IPv6Address
"""A DNS name, or an address."""

_ELSEWHERE = ("192.0.2.1", "2001:db8::1")  # of documentation: nothing is sent there
_IPV6_TABLE = Path("/proc/net/if_inet6")
_ASK_ADDRESS = 0x8915  # SIOCGIFADDR
_NAME = re.compile(r"(?!-)[a-z0-9-]{1,63}(\.[a-z0-9-]{1,63})*")


def local_addresses() -> list[Address]:
    """Return this machine's own names and addresses: localhost first, nothing twice."""
    host = socket.gethostname().lower()
    names = [name for name in ("localhost", host, f"{host.split('.')[0]}.local") if _NAME.fullmatch(name)]
    found = {ipaddress.ip_address("127.0.0.1"), ipaddress.ip_address("::1")}
    found.update(_of_interfaces() if sys.platform == "linux" else _of_routes())
    addresses = sorted(found, key=lambda address: (not address.is_loopback, address.version, int(address)))
    return [*dict.fromkeys(names), *(address for address in addresses if not address.is_link_local)]


def parsed(texts: Iterable[str]) -> list[Address]:
    """Return names and addresses that a person wrote.

    Raises:
        ConfigError: If one is neither.
    """
    return [_parsed(text.strip().lower()) for text in texts]


def _parsed(text: str) -> Address:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        if not _NAME.fullmatch(text):
            raise ConfigError(f"--name {text!r} is neither a host's name nor an address") from None
        return text


def _of_interfaces() -> Iterator[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    """Yield the addresses of every interface, as Linux knows them."""
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            try:
                answer = fcntl.ioctl(asking, _ASK_ADDRESS, struct.pack("256s", name.encode()[:15]))
            except OSError:
                continue  # it has none
            yield ipaddress.IPv4Address(answer[20:24])
    if _IPV6_TABLE.exists():
        for line in _IPV6_TABLE.read_text(encoding="ascii").splitlines():
            yield ipaddress.IPv6Address(bytes.fromhex(line.split()[0]))


def _of_routes() -> Iterator[ipaddress.IPv4Address | ipaddress.IPv6Address]:
    """Yield the addresses from which this machine would reach others."""
    for target in _ELSEWHERE:
        family = socket.AF_INET6 if ":" in target else socket.AF_INET
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as asking:
                asking.connect((target, 9))
                yield ipaddress.ip_address(asking.getsockname()[0].partition("%")[0])
        except OSError:
            continue  # no such network

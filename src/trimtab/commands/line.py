"""What `vehicle`, `fly` and their relatives share: the line, its key, and how they are ended."""

import contextlib
import ipaddress
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import click

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.links.open_link import parse_uri
from trimtab.live.connection_problem import COMPUTER_CLOCK, STORED_CLOCK
from trimtab.live.machine import SYSTEM_MACHINE, Machine
from trimtab.scenarios import catalogue
from trimtab.wire.dialect import Dialect
from trimtab.wire.keys import SigningKey, create_key, key_path, load_key
from trimtab.wire.mavlink import Endpoint
from trimtab.wire.stamps import running_clock

VEHICLE, AUTOPILOT, INJECTOR = (1, 1), (1, 191), (1, 192)
"""System and component of the ends."""
LIVE_CHOICES = {"supervisor": "automatic", "stick": "console"}
"""What a scenario's settings are in real time, unless something else is asked for."""
DATAGRAMS = ("udp",)
QUICK_LINES = ("udp", "tcp", "loopback")
QUICK_TRANSFER, SLOW_TRANSFER = 200e3, 4e3
"""Bytes a second of a file at most, over a network, and over a radio or a serial line, a third of 115200 baud."""


def current_machine() -> Machine:
    """Return the computer that the command runs on: this one, unless the command was handed another."""
    context = click.get_current_context(silent=True)
    return (None if context is None else context.find_object(Machine)) or SYSTEM_MACHINE


def is_local(uri: str) -> bool:
    """Whether only this machine can reach a line."""
    address = parse_uri(uri)
    if address.scheme == "loopback":
        return True
    if address.scheme not in ("udp", "tcp"):
        return False
    host, _ = address.host_and_port()
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def live_settings(scenario: str, names: Sequence[str] = tuple(LIVE_CHOICES)) -> dict[str, str]:
    """In real time a supervisor watches and a pilot has the stick, where the scenario offers that."""
    offered = catalogue.scenario_choices(scenario)
    return {name: LIVE_CHOICES[name] for name in names if LIVE_CHOICES[name] in offered.get(name, ())}


def transfer_rate(uri: str) -> float:
    """How quickly files may travel over a line (bytes/s)."""
    return QUICK_TRANSFER if parse_uri(uri).scheme in QUICK_LINES else SLOW_TRANSFER


def vehicle_name(scenario: str) -> str:
    """Whose key a scenario's line is signed with: the catalogue's folder, or a file's or module's name."""
    where, own, _ = scenario.partition(":")
    if where.endswith(".fmu"):
        return Path(where).stem
    return Path(where).stem if own and where.endswith(".py") else where.partition("/")[0]


def find_key(scenario: str, file: Path | None, unsigned: bool, uri: str, *, create: bool) -> SigningKey | None:
    """The key that both ends sign with; None where unsigned was asked for on a line that only this machine reaches.

    Args:
        scenario: tells the vehicle, see `vehicle_name`: there is one key a vehicle.
        file: the key's, where it is not in its usual place.
        unsigned: whether to go without.
        uri: the line; refused here where it is none.
        create: make a new key where there is none.
    """
    parse_uri(uri)
    if unsigned:
        if not is_local(uri):
            problem = f"whoever reaches {uri} could command the vehicle"
            raise InputError("--unsigned", problem, fix="leave it out, or use udp://127.0.0.1:14550 or loopback://NAME")
        if file is not None:
            raise InputError("--unsigned", "there is a --key too", fix="leave one of them out")
        return None
    path = file or key_path(vehicle_name(scenario))
    if path.exists():
        return load_key(path)
    if not create:
        problem = f"there is no key: {path}"
        start = f"trimtab vehicle {shlex.quote(scenario)} --listen {shlex.quote(uri)}"
        raise InputError("--key", problem, fix=f"{start}  here makes it; from another computer copy the file to it")
    key = create_key(path)
    click.echo(f"new key {path}: copy it to the other computer, and to nobody else", err=True)
    return key


def endpoint_factory(
    line: str, who: tuple[int, int], key: SigningKey | None, clock: str = STORED_CLOCK
) -> Callable[[Dialect], Endpoint]:
    """What makes one end's endpoint of a line. clock: by which it signs."""
    datagrams, machine = parse_uri(line).scheme in DATAGRAMS, current_machine()

    def make(dialect: Dialect) -> Endpoint:
        return Endpoint(
            dialect,
            *who,
            key,
            unsigned=key is None,
            datagrams=datagrams,
            clock=running_clock(machine.clock),
            is_reset=clock == COMPUTER_CLOCK,
            session=machine.draw_session(),
        )

    return make


@contextlib.contextmanager
def open_line(uri: str, *, listen: bool) -> Iterator[Link]:
    """A link, closed at the end."""
    link = current_machine().open_link(uri, listen=listen)
    try:
        yield link
    finally:
        link.close()

"""Functions shared by the subcommands `vehicle`, `fly` and `inject`: link, signing key and MAVLink endpoint."""

import contextlib
import ipaddress
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import click

from trimtab.core.errors import InputError
from trimtab.core.interfaces import Link
from trimtab.flight.connection_problem import COMPUTER_CLOCK, STORED_CLOCK
from trimtab.flight.machine import SYSTEM_MACHINE, Machine
from trimtab.flight.mavlink.dialect import Dialect
from trimtab.flight.mavlink.endpoint import Endpoint
from trimtab.flight.mavlink.keys import SigningKey, create_key, key_path, load_key
from trimtab.flight.mavlink.stamps import running_clock
from trimtab.flight.transports.open_link import parse_uri
from trimtab.scenarios import catalogue

VEHICLE, AUTOPILOT, INJECTOR = (1, 1), (1, 191), (1, 192)
"""MAVLink system and component IDs of vehicle, autopilot and injector."""
LIVE_CHOICES = {"supervisor": "automatic", "stick": "console"}
"""Settings of a scenario in real time. The user may override them."""
DATAGRAMS = ("udp",)
QUICK_LINES = ("udp", "tcp", "loopback")
QUICK_TRANSFER, SLOW_TRANSFER = 200e3, 4e3
"""Maximum file transfer rates (bytes/s) over a network, and over a radio or serial link (a third of 115200 baud)."""


def current_machine() -> Machine:
    """Return the machine (clock, files, …) on which the command runs: that in the click context, else this computer."""
    context = click.get_current_context(silent=True)
    return (None if context is None else context.find_object(Machine)) or SYSTEM_MACHINE


def is_local(uri: str) -> bool:
    """Return True if only this machine can reach the link."""
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
    """Return the supervisor and stick settings of LIVE_CHOICES, as far as the scenario offers these choices."""
    offered = catalogue.scenario_choices(scenario)
    return {name: LIVE_CHOICES[name] for name in names if LIVE_CHOICES[name] in offered.get(name, ())}


def transfer_rate(uri: str) -> float:
    """Return the maximum rate of file transfers over a link (bytes/s)."""
    return QUICK_TRANSFER if parse_uri(uri).scheme in QUICK_LINES else SLOW_TRANSFER


def vehicle_name(scenario: str) -> str:
    """Return the name of the vehicle's signing key: the scenario's catalogue folder, or a file or module name.

    A character of a file's name that a key's name must not contain, such as a space, is replaced by '-'.
    """
    where, own, _ = scenario.partition(":")
    if where.endswith(".fmu") or (own and where.endswith(".py")):
        return re.sub(r"[^A-Za-z0-9_.-]", "-", Path(where).stem)[:64].lstrip("-._") or "vehicle"
    return where.partition("/")[0]


def find_key(scenario: str, file: Path | None, unsigned: bool, uri: str, *, create: bool) -> SigningKey | None:
    """Return the signing key of a link's two ends, or None for an unsigned link within this machine.

    Args:
        scenario: name of the scenario, which determines the vehicle, see `vehicle_name`. Each vehicle has one key.
        file: path of the key file, or None for the default path.
        unsigned: True for a link without signatures.
        uri: URI of the link; InputError if it is invalid.
        create: True to create a new key if the file is missing.
    """
    parse_uri(uri)
    if unsigned:
        if not is_local(uri):
            problem = f"anyone who reaches {uri} could command the vehicle"
            raise InputError("--unsigned", problem, fix="leave it out, or use udp://127.0.0.1:14550 or loopback://NAME")
        if file is not None:
            raise InputError("--unsigned", "cannot be combined with --key", fix="leave one of the two out")
        return None
    path = file or key_path(vehicle_name(scenario))
    if path.exists():
        return load_key(path)
    if not create:
        problem = f"key not found: {path}"
        start = f"trimtab vehicle {shlex.quote(scenario)} --listen {shlex.quote(uri)}"
        raise InputError(
            "--key",
            problem,
            fix=f"{start}  creates a key on this computer; otherwise copy the key file from the vehicle's computer",
        )
    key = create_key(path)
    click.echo(f"new key {path}: copy it to the other computer, and keep it secret", err=True)
    return key


def endpoint_factory(
    line: str, who: tuple[int, int], key: SigningKey | None, clock: str = STORED_CLOCK
) -> Callable[[Dialect], Endpoint]:
    """Return a function that creates the MAVLink endpoint of one end of a link. clock: clock for the signatures."""
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
    """Open a link, and close the link at the end of the `with` block."""
    link = current_machine().open_link(uri, listen=listen)
    try:
        yield link
    finally:
        link.close()

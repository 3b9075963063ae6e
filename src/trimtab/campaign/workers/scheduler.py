"""Where the scheduler of a cluster is, with which certificates it is spoken to, and whether it can be.

Source: Rescorla, "The transport layer security (TLS) protocol version 1.3", RFC 8446.
"""

import contextlib
import ipaddress
import re
import socket
import ssl
from pathlib import Path
from typing import NamedTuple

from trimtab.core.errors import InputError

REACHED = 10.0
"""Seconds in which a scheduler answers a call."""
PLACE = re.compile(r"(\w+)://(\[[0-9a-fA-F:.]+\]|[^\s:/\[\]]+):(\d{1,5})/?")


class Place(NamedTuple):
    """Where the scheduler is, and with what this machine shows who it is; no files for plain TCP."""

    uri: str
    host: str
    port: int
    files: tuple[str, str, str] | None


def place_of(uri: str, files: dict[str, str]) -> Place:
    """Refuse what is no address, and plain TCP between machines."""
    found = PLACE.fullmatch(uri.strip())
    if not found or found[1] not in ("tls", "tcp") or not 0 < int(found[3]) < 2**16:
        raise InputError("--cluster", f"{uri!r} is not tls://HOST:PORT", fix="--cluster tls://10.0.0.1:8786")
    host, port = found[2].strip("[]"), int(found[3])
    flags = "--tls-ca ca.pem --tls-cert me.pem --tls-key me.key"
    if found[1] == "tcp":
        if not _loopback(host):
            problem = f"{uri}: without TLS anyone who reaches the port runs programs on every machine of the cluster"
            raise InputError("--cluster", problem, fix=f"--cluster tls://{found[2]}:{port} {flags}")
        if any(files.values()):
            raise InputError("--cluster", f"{uri} uses no certificates", fix=f"--cluster tls://{found[2]}:{port}")
        return Place(uri, host, port, None)
    for flag, name in files.items():
        if not name:
            raise InputError(flag, "tls:// needs an authority, a certificate and its key", fix=f"{flags}")
        if not Path(name).is_file():
            raise InputError(flag, f"there is no file {name!r}", fix=f"{flag} with a PEM file")
    place = Place(f"tls://{found[2]}:{port}", host, port, (files["--tls-ca"], files["--tls-cert"], files["--tls-key"]))
    _context(place)
    return place


def _loopback(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def _context(place: Place) -> ssl.SSLContext:
    """What distributed makes of the files too; refuses those that are none or don't belong together."""
    ca, cert, key = place.files or ("", "", "")
    try:
        context = ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=ca)
        context.check_hostname = False
        context.load_cert_chain(cert, key)
    except (ssl.SSLError, OSError) as error:
        problem = f"{ca}, {cert} and {key} can't be used: {error.reason if isinstance(error, ssl.SSLError) else error}"
        raise InputError("--tls-ca, --tls-cert, --tls-key", problem, fix="see the page, certificates") from None
    return context


def greet(place: Place) -> None:
    """Refuse a scheduler that isn't there or isn't trusted, or that doesn't trust; distributed says "timed out"."""
    part = f"--cluster {place.uri}"
    try:
        with socket.create_connection((place.host, place.port), REACHED) as plain:
            if place.files is None:
                return
            with _context(place).wrap_socket(plain) as safe:
                if not safe.recv(1):  # a scheduler speaks first, to those whose certificate it takes
                    raise ssl.SSLError("it closed the line")
    except ssl.SSLCertVerificationError as error:
        problem = f"its certificate is not of the authority in {place.files and place.files[0]}: {error.verify_message}"
        raise InputError(part, problem, fix="--tls-ca with the ca.pem that the scheduler was started with") from None
    except ssl.SSLError as error:
        problem = f"it refuses the certificate: {error.reason or error}"
        fix = "--tls-cert and --tls-key signed by the authority that the scheduler was started with"
        raise InputError(part, problem, fix=fix) from None
    except OSError as error:
        problem = f"no scheduler is reached there: {error.strerror or error}"
        scheme = "tls" if place.files else "tcp"
        fix = f"on that machine:  dask scheduler --protocol {scheme} --port {place.port} …, and open the port"
        raise InputError(part, problem, fix=fix) from None

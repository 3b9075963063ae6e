"""Network address of a console, which is reachable only from this machine, or encrypted with TLS."""

import contextlib
import ipaddress
import socket
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from trimtab.core.errors import InputError, argument, argument_name, install_command

NEEDS = ("starlette", "uvicorn", "websockets")


class ConsoleAddress(NamedTuple):
    """Network address on which a console listens.

    certificate, private_key: files for TLS. Without these files, only browsers on this machine are served.  opens: True
    to open a browser.
    """

    host: str = "127.0.0.1"
    port: int = 0
    certificate: Path | None = None
    private_key: Path | None = None
    opens: bool = False

    def check(self) -> None:
        """Raise InputError if other machines could reach the address without encryption, or if a library is missing."""
        missing = [name for name in NEEDS if find_spec(name) is None]
        if missing:
            problem = f"{missing[0]} is not installed"
            raise InputError("the console", problem, fix=install_command("console"))
        if (self.certificate is None) != (self.private_key is None):
            raise InputError(
                argument_name("certificate"),
                "the certificate and its private key must be given together",
                fix="give both",
            )
        if self.certificate is None and not self._is_loopback:
            problem = f"anyone on the network path to {self.host} could read the token and fly the craft"
            fix = (
                f"{argument('certificate', 'FILE')} {argument('private_key', 'FILE')} "
                "(openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 "
                f"-nodes -days 30 -subj /CN={self.host} -out console.pem -keyout console.key)"
            )
            raise InputError(argument_name("bind"), problem, fix=fix)

    @property
    def files(self) -> dict[str, str | None]:
        """Return the paths of the TLS certificate and of the private key, by option name."""
        own = {"certificate": self.certificate, "private_key": self.private_key}
        return {name: None if file is None else str(file) for name, file in own.items()}

    @property
    def _is_loopback(self) -> bool:
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"


def open_listener(address: ConsoleAddress) -> socket.socket:
    """Open the socket to which pages connect, and return the socket."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((address.host, address.port))
    except OSError as error:
        listener.close()
        problem = f"cannot listen on {address.host}:{address.port}: {(error.strerror or str(error)).lower()}"
        raise InputError(argument_name("port"), problem, fix=f"{argument('port', 0)} selects a free port") from None
    listener.listen(64)
    return listener

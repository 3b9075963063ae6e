"""Keys with which vehicle and autopilot sign their packets. Each vehicle has one key file, which only the file's owner
can read.

A key file contains one line, a passphrase. The key is the SHA-256 of the passphrase. So a ground station can compute
the same key from the passphrase, e.g. MAVProxy by `signing key LINE`.
Source: https://mavlink.io/en/guide/message_signing.html; MAVProxy's module `signing` computes a key from a passphrase
in the same way.
"""

import hashlib
import os
import re
import secrets
import stat
from pathlib import Path
from typing import NamedTuple

from trimtab.core.errors import InputError

SHORTEST_PASSPHRASE = 16
LONGEST_FILE = 4096


class SigningKey(NamedTuple):
    """Signing key of 32 bytes, and the path of the key file or None. Time stamps are stored beside the key file."""

    secret: bytes
    path: Path | None = None

    def __repr__(self) -> str:
        """Return a text for logs and error messages, which does not contain the key."""
        return f"Key(path={str(self.path)!r})"


def passphrase_key(passphrase: str, path: Path | None = None) -> SigningKey:
    """Return the key that belongs to a passphrase: the SHA-256 of the passphrase."""
    if len(passphrase) < SHORTEST_PASSPHRASE or not re.fullmatch(r"[!-~]+", passphrase):
        problem = f"a passphrase must have at least {SHORTEST_PASSPHRASE} printable ASCII characters without spaces"
        fix = "use `create_key` to make a passphrase; a short one can be guessed from one recorded packet"
        raise InputError("signing key", problem, fix=fix)
    return SigningKey(hashlib.sha256(passphrase.encode()).digest(), path)


def key_path(vehicle: str) -> Path:
    """Return the path of a vehicle's key file: keys/VEHICLE.key in the folder $TRIMTAB_CONFIG if it is set, otherwise
    in the folder trimtab of $XDG_CONFIG_HOME."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", vehicle):
        problem = f"{vehicle!r} is not a valid name of a vehicle"
        raise InputError("signing key", problem, fix="use letters, digits, '-', '_' and '.', e.g. hovercraft-1")
    try:
        default = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "trimtab"
    except RuntimeError:
        problem = "no home folder found for the keys"
        raise InputError("signing key", problem, fix="set TRIMTAB_CONFIG to a folder that you can write") from None
    return Path(os.environ.get("TRIMTAB_CONFIG") or default).absolute() / "keys" / f"{vehicle}.key"


def create_key(path: Path, passphrase: str = "") -> SigningKey:
    """Make a new key and write the key file, readable by its owner only. An existing file is never overwritten.

    Args:
        path: path of the file.
        passphrase: passphrase to write. If it is empty, a random passphrase of 256 bits is used.
    """
    passphrase = passphrase or secrets.token_urlsafe(32)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(passphrase + "\n")
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        problem = (
            "the file already exists; if it were replaced, packets signed with the existing key would no longer be "
            "accepted"
        )
        raise InputError(
            f"key file '{path}'", problem, fix=f"use the existing key, or first remove it:  rm '{path}'"
        ) from None
    except OSError as error:
        problem = f"the file cannot be written: {error.strerror or error}"
        raise InputError(f"key file '{path}'", problem, fix="choose a folder that you can write") from None
    return passphrase_key(passphrase, path)


def load_key(path: Path) -> SigningKey:
    """Read a key file. Raise InputError if other users can read or change it."""
    where = f"key file '{path}'"
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        fix = (
            f"make a key by create_key(Path({str(path)!r})) on one computer, and copy the file to the other computer "
            "by hand"
        )
        raise InputError(where, f"the file cannot be read: {error.strerror or error}", fix=fix) from None
    try:
        _check_key_file(where, path, os.fstat(descriptor))
        text = os.read(descriptor, LONGEST_FILE + 1)
    finally:
        os.close(descriptor)
    try:
        if len(text) > LONGEST_FILE:
            raise InputError(where, "is too long")
        return passphrase_key(text.decode("ascii").strip(), path)
    except (UnicodeDecodeError, InputError):
        problem = (
            f"the file contains no key: it must have one line of at least {SHORTEST_PASSPHRASE} printable ASCII "
            "characters"
        )
        raise InputError(
            where, problem, fix="copy the key file again from the other computer, or make a new key for both"
        ) from None


def _check_key_file(where: str, path: Path, about: os.stat_result) -> None:
    if not stat.S_ISREG(about.st_mode):
        raise InputError(where, "the path is not a file", fix="use the path of a key file")
    if not hasattr(os, "getuid"):
        return
    if about.st_uid != os.getuid():
        raise InputError(where, "the file belongs to another user", fix=f"chown {os.getuid()} '{path}'")
    if about.st_mode & 0o077:
        problem = f"the file is not secret: other users can read or change it (mode {stat.S_IMODE(about.st_mode):04o})"
        raise InputError(where, problem, fix=f"chmod 600 '{path}'")

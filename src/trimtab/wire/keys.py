"""Keys with which two ends sign what they send each other: one file a vehicle, readable by its owner alone.

A key file holds one line, a passphrase; the key is its SHA-256. So a ground station gets the same key by the line
itself, e.g. MAVProxy by `signing key LINE`.
Source: https://mavlink.io/en/guide/message_signing.html; the passphrase form is that of MAVProxy's module `signing`.
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
    """A key of 32 bytes, and the file it comes from, beside which time stamps are kept; None for one held in memory."""

    secret: bytes
    path: Path | None = None

    def __repr__(self) -> str:
        """Without the secret: logs and error messages show keys by what this gives."""
        return f"Key(path={str(self.path)!r})"


def passphrase_key(passphrase: str, path: Path | None = None) -> SigningKey:
    """The key that a passphrase stands for: its SHA-256."""
    if len(passphrase) < SHORTEST_PASSPHRASE or not re.fullmatch(r"[!-~]+", passphrase):
        problem = f"a passphrase needs {SHORTEST_PASSPHRASE} or more printable ASCII characters without spaces"
        fix = "let `create_key` make one: who records one packet can try short ones at leisure"
        raise InputError("signing key", problem, fix=fix)
    return SigningKey(hashlib.sha256(passphrase.encode()).digest(), path)


def key_path(vehicle: str) -> Path:
    """Where the key of a vehicle lies: keys/VEHICLE.key in $TRIMTAB_CONFIG, else trimtab in $XDG_CONFIG_HOME."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", vehicle):
        problem = f"{vehicle!r} can't be the name of a vehicle"
        raise InputError("signing key", problem, fix="use letters, digits, '-', '_' and '.', e.g. hovercraft-1")
    try:
        default = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "trimtab"
    except RuntimeError:
        problem = "there is no home folder to keep keys in"
        raise InputError("signing key", problem, fix="set TRIMTAB_CONFIG to a folder of yours") from None
    return Path(os.environ.get("TRIMTAB_CONFIG") or default).absolute() / "keys" / f"{vehicle}.key"


def create_key(path: Path, passphrase: str = "") -> SigningKey:
    """Make a new key and write its file, readable by its owner only; a file that exists is never overwritten.

    Args:
        path: of the file.
        passphrase: line of the file; empty: 256 random bits.
    """
    passphrase = passphrase or secrets.token_urlsafe(32)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(passphrase + "\n")
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        problem = "is there already; what it signs would no longer be accepted"
        raise InputError(f"key file '{path}'", problem, fix=f"use it, or  rm '{path}'  first") from None
    except OSError as error:
        problem = f"cannot be written: {error.strerror or error}"
        raise InputError(f"key file '{path}'", problem, fix="choose a folder of yours") from None
    return passphrase_key(passphrase, path)


def load_key(path: Path) -> SigningKey:
    """Read a key file; refused where others can read or change it."""
    where = f"key file '{path}'"
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        fix = f"make one by create_key(Path({str(path)!r})) on one end, and copy the file to the other by hand"
        raise InputError(where, f"cannot be read: {error.strerror or error}", fix=fix) from None
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
        problem = f"holds no key: one line of {SHORTEST_PASSPHRASE} or more printable ASCII characters is expected"
        raise InputError(where, problem, fix="copy it again from the other end, or make a new one on both") from None


def _check_key_file(where: str, path: Path, about: os.stat_result) -> None:
    if not stat.S_ISREG(about.st_mode):
        raise InputError(where, "is not a file", fix="give the path of a key file")
    if not hasattr(os, "getuid"):
        return
    if about.st_uid != os.getuid():
        raise InputError(where, "belongs to somebody else", fix=f"chown {os.getuid()} '{path}'")
    if about.st_mode & 0o077:
        problem = f"others can read or change it (mode {stat.S_IMODE(about.st_mode):04o})"
        raise InputError(where, problem, fix=f"chmod 600 '{path}'")

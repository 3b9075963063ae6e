"""Keys with which two ends sign their packets: one file per vehicle, which only its owner can read.

A key file contains one line, a passphrase. The key is the SHA-256 of the passphrase. So a ground station computes the
same key from that line, e.g. MAVProxy by `signing key LINE`.
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
    """Key of 32 bytes, and path of its file, or None. Time stamps are stored beside that file."""

    secret: bytes
    path: Path | None = None

    def __repr__(self) -> str:
        """Return a text without the secret, for logs and error messages."""
        return f"Key(path={str(self.path)!r})"


def passphrase_key(passphrase: str, path: Path | None = None) -> SigningKey:
    """Return the key of a passphrase: its SHA-256."""
    if len(passphrase) < SHORTEST_PASSPHRASE or not re.fullmatch(r"[!-~]+", passphrase):
        problem = f"a passphrase must have at least {SHORTEST_PASSPHRASE} printable ASCII characters without spaces"
        fix = "let `create_key` make one: short passphrases can be guessed from one recorded packet"
        raise InputError("signing key", problem, fix=fix)
    return SigningKey(hashlib.sha256(passphrase.encode()).digest(), path)


def key_path(vehicle: str) -> Path:
    """Return the path of a vehicle's key: keys/VEHICLE.key in $TRIMTAB_CONFIG, else trimtab in $XDG_CONFIG_HOME."""
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
    """Make a new key and write its file, readable by its owner only. An existing file is never overwritten.

    Args:
        path: path of the file.
        passphrase: passphrase to write; empty: a random one of 256 bits.
    """
    passphrase = passphrase or secrets.token_urlsafe(32)
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(passphrase + "\n")
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        problem = "already exists; packets signed with it would no longer be accepted"
        raise InputError(f"key file '{path}'", problem, fix=f"use this key, or  rm '{path}'  first") from None
    except OSError as error:
        problem = f"cannot be written: {error.strerror or error}"
        raise InputError(f"key file '{path}'", problem, fix="choose a folder that you can write") from None
    return passphrase_key(passphrase, path)


def load_key(path: Path) -> SigningKey:
    """Read a key file. Raise InputError if other users can read or change it."""
    where = f"key file '{path}'"
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        fix = f"make a key by create_key(Path({str(path)!r})) on one end, and copy the file to the other end by hand"
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
        problem = f"contains no key: one line of {SHORTEST_PASSPHRASE} or more printable ASCII characters expected"
        raise InputError(
            where, problem, fix="copy the key file again from the other end, or make a new key for both ends"
        ) from None


def _check_key_file(where: str, path: Path, about: os.stat_result) -> None:
    if not stat.S_ISREG(about.st_mode):
        raise InputError(where, "is not a file", fix="give the path of a key file")
    if not hasattr(os, "getuid"):
        return
    if about.st_uid != os.getuid():
        raise InputError(where, "belongs to another user", fix=f"chown {os.getuid()} '{path}'")
    if about.st_mode & 0o077:
        problem = f"other users can read or change it (mode {stat.S_IMODE(about.st_mode):04o})"
        raise InputError(where, problem, fix=f"chmod 600 '{path}'")

"""Files that a user names. Only plain files are read: a pipe could block, and a device could fill the memory."""

import codecs
import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

LARGEST_TEXT = 1 << 28
"""Maximum size of a text file (bytes)."""
SHOWN = 40
"""Maximum number of characters of a line that an error message shows."""


class EncodingError(UnicodeDecodeError):
    """Error for a file that is not text in UTF-8. The message names the first line that is not."""

    def __str__(self) -> str:
        if self.object.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return "the text is in UTF-16, not in UTF-8"
        lines, before = self.object.splitlines(), self.object[: self.start].splitlines(keepends=True)
        number = len(before) + (not before or before[-1].endswith((b"\r", b"\n")))
        shown = lines[number - 1][:SHOWN].decode("latin-1")
        return f"line {number} is not in UTF-8; read as Latin-1, it is {shown!r}"


def open_user_file(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a plain file for reading. Raise OSError if the file cannot be read, or is a pipe, a device or a folder."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return open(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "not a plain file", str(path))


def read_user_bytes(path: str | os.PathLike[str], largest: int | None = None) -> bytes:
    """Return the content of a plain file.

    Args:
        path: path of the file.
        largest: maximum size (bytes), or None for no limit.

    Raises:
        OSError: if the file cannot be read, is a pipe, a device or a folder, or is too large.
    """
    with open_user_file(path) as file:
        if largest is not None and os.fstat(file.fileno()).st_size > largest:
            raise OSError(errno.EFBIG, f"larger than {largest // 10**6} MB", str(path))
        return file.read()


def read_user_text(path: str | os.PathLike[str], largest: int = LARGEST_TEXT) -> str:
    """Return the text of a plain file in UTF-8, with every line end converted to a line feed.

    A byte-order mark, which some editors write at the start of a file, is left out.

    Raises:
        OSError: if the file cannot be read, is a pipe, a device or a folder, or is larger than `largest`.
        EncodingError: if the file is not text in UTF-8.
    """
    data = read_user_bytes(Path(path), largest)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise EncodingError("utf-8", data, error.start, error.end, error.reason) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")

"""Files that a user names: a pipe, a device and a folder are refused at once."""

import os

import pytest

from trimtab.core.user_file import open_user_file, read_user_bytes, read_user_text


def test_reads_plain_file_with_any_line_ending(tmp_path):
    (tmp_path / "a.txt").write_bytes("1\r\n2\r3\nµ".encode())
    assert read_user_text(tmp_path / "a.txt") == "1\n2\n3\nµ"
    assert read_user_bytes(tmp_path / "a.txt").startswith(b"1\r\n")
    (tmp_path / "marked.txt").write_bytes("\ufeff1\n".encode())
    assert read_user_text(tmp_path / "marked.txt") == "1\n"
    (tmp_path / "link").symlink_to("a.txt")
    with open_user_file(tmp_path / "link") as file:
        assert file.read(1) == b"1"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a\r\nb \xb0\r\n", r"line 2 is not in UTF-8; read as Latin-1, it is 'b °'"),
        (b"\xb0", "line 1 is not in UTF-8"),
        ("a".encode("utf-16"), "the text is in UTF-16"),
        (b"\xfe\xff\x00a", "the text is in UTF-16"),
        (b"a\n\xb0b\n", "line 2 is not in UTF-8; read as Latin-1, it is '°b'"),
        (b"\xb0" * 99, f"'{40 * '°'}'"),
    ],
)
def test_text_in_another_encoding_is_named_by_line(content, said, tmp_path):
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(UnicodeDecodeError, match=said):
        read_user_text(tmp_path / "a.txt")


def test_rejects_pipe_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a plain file"):
        read_user_text(tmp_path / "pipe")


@pytest.mark.skipif(not os.path.exists("/dev/zero"), reason="no /dev/zero here")
def test_rejects_device_without_reading_it():
    with pytest.raises(OSError, match="not a plain file"):
        read_user_bytes("/dev/zero")


def test_rejects_folder_and_oversized_file(tmp_path):
    with pytest.raises(IsADirectoryError):
        read_user_text(tmp_path)
    with (tmp_path / "large").open("wb") as file:
        file.truncate(3_000_001)
    with pytest.raises(OSError, match="larger than 3 MB"):
        read_user_text(tmp_path / "large", largest=3_000_000)

import hashlib
import os
import stat

import pytest

from trimtab.core.errors import InputError
from trimtab.flight.mavlink.keys import create_key, key_path, load_key, passphrase_key


def test_a_new_key_is_random_owner_only_and_read_back(tmp_path):
    path = tmp_path / "keys" / "a.key"
    made, other = create_key(path), create_key(tmp_path / "b.key")
    assert made == load_key(path)
    assert len(made.secret) == 32
    assert made.secret != other.secret
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_key_is_the_sha256_of_the_file_line(tmp_path):
    """MAVProxy's `signing key LINE` takes the SHA-256 of the line's ASCII bytes."""
    path = tmp_path / "a.key"
    made = create_key(path)
    line = path.read_text("ascii").strip()
    assert " " not in line
    assert made.secret == hashlib.sha256(line.encode("ascii")).digest()


def test_existing_key_file_is_not_overwritten(tmp_path):
    path = tmp_path / "a.key"
    made = create_key(path)
    with pytest.raises(InputError, match="already exists"):
        create_key(path)
    assert load_key(path) == made


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o610])
def test_rejects_key_file_accessible_to_others(tmp_path, mode):
    path = tmp_path / "a.key"
    create_key(path)
    path.chmod(mode)
    with pytest.raises(InputError, match=f"chmod 600 '{path}'"):
        load_key(path)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_rejects_key_file_of_another_user(tmp_path):
    path = tmp_path / "a.key"
    create_key(path)
    os.chown(path, 12345, -1)
    with pytest.raises(InputError, match="belongs to another user"):
        load_key(path)


@pytest.mark.parametrize("content", [b"", b"short\n", b"\xff" * 40, b"two words are not one passphrase", b"a" * 5000])
def test_a_file_without_a_key_is_refused(tmp_path, content):
    path = tmp_path / "a.key"
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(InputError, match="contains no key"):
        load_key(path)


def test_rejects_missing_key_file_or_non_file(tmp_path):
    with pytest.raises(InputError, match="make a key by create_key"):
        load_key(tmp_path / "none.key")
    with pytest.raises(InputError, match="is not a file"):
        load_key(tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(InputError, match="is not a file"):
        load_key(tmp_path / "pipe")


def test_default_key_folder_follows_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("TRIMTAB_CONFIG", str(tmp_path / "own"))
    assert key_path("boat-1") == tmp_path / "own" / "keys" / "boat-1.key"
    monkeypatch.delenv("TRIMTAB_CONFIG")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert key_path("boat-1") == tmp_path / "trimtab" / "keys" / "boat-1.key"


@pytest.mark.parametrize("name", ["", "../a", ".hidden", "a/b", "a b"])
def test_rejects_vehicle_names_that_are_paths(name):
    with pytest.raises(InputError, match="is not a valid name of a vehicle"):
        key_path(name)


def test_short_passphrases_are_refused():
    with pytest.raises(InputError, match="at least 16"):
        passphrase_key("fifteen-letters")


def test_secret_is_not_shown_in_repr():
    key = passphrase_key("correct-horse-battery-staple")
    assert key.secret.hex()[:8] not in repr(key)
    assert repr(key.secret)[2:10] not in f"{key} {[key]}"

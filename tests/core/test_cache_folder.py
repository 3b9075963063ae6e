"""Folders of the user's cache."""

import os
from pathlib import Path

import jax
import pytest

from trimtab.core.cache_folder import cache_folder, enable_cache, is_owned_by_user


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("TRIMTAB_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def test_prefers_trimtab_cache_then_xdg_cache_then_home(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder("a") == home / ".cache" / "trimtab" / "a"
    monkeypatch.setenv("XDG_CACHE_HOME", str(home / "xdg"))
    assert cache_folder("a") == home / "xdg" / "trimtab" / "a"
    monkeypatch.setenv("TRIMTAB_CACHE", str(home / "own"))
    assert cache_folder("a") == home / "own" / "a"


def test_folder_is_absolute_and_private_to_its_owner(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(home)
    monkeypatch.setenv("TRIMTAB_CACHE", "here")
    folder = cache_folder("a")
    assert folder == home / "here" / "a"
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_rejects_folder_that_others_can_write_to(home: Path, mode: int) -> None:
    cache_folder("a").chmod(mode)
    with pytest.raises(PermissionError, match="others can write"):
        cache_folder("a")


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give files away")
def test_rejects_folder_of_another_user(home: Path) -> None:
    os.chown(cache_folder("a"), 12345, -1)
    with pytest.raises(PermissionError, match="another user"):
        cache_folder("a")


def test_accepts_folder_that_others_can_read(home: Path) -> None:
    cache_folder("a").chmod(0o755)
    assert is_owned_by_user(cache_folder("a").stat())


def test_raises_os_error_where_a_file_takes_the_folders_place(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (home / "file").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(home / "file"))
    with pytest.raises(OSError, match="file"):
        cache_folder("a")


def test_raises_os_error_for_unknown_home(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as where there is neither HOME nor an entry of it
    with pytest.raises(FileNotFoundError, match="home"):
        cache_folder("a")


def test_jax_cache_lies_inside_the_trimtab_cache(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {}
    monkeypatch.setattr(jax.config, "update", settings.__setitem__)
    enable_cache()
    assert settings["jax_compilation_cache_dir"] == str(home / ".cache" / "trimtab" / "jax")
    settings.clear()
    (home / "file").write_text("")
    monkeypatch.setenv("TRIMTAB_CACHE", str(home / "file"))
    enable_cache()
    assert settings == {}

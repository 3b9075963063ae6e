import os

import pytest

from trimtab.core.errors import InputError
from trimtab.flight.transports.open_link import open_link


def test_loopback_socket_is_restricted_to_its_owner(runtime, monkeypatch):
    server = open_link("loopback://mine", listen=True)
    folder = runtime / "trimtab"
    assert folder.stat().st_mode & 0o777 == 0o700
    with pytest.raises(InputError, match="another process listens under this name"):
        open_link("loopback://mine", listen=True)
    server.close()
    assert not (folder / "mine.link").exists()
    (folder / "mine.link").write_text("left behind")  # as after kill -9
    open_link("loopback://mine", listen=True).close()
    folder.chmod(0o755)
    with pytest.raises(InputError, match=r"other users have access to the folder.*\nFix: chmod 700"):
        open_link("loopback://mine")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(runtime))
    open_link("loopback://mine", listen=True).close()
    assert (runtime / f"trimtab-{os.getuid()}").stat().st_mode & 0o777 == 0o700

"""Compilers that fail in chosen ways: shell scripts around the real one."""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

REAL = {"c": "gcc", "c++": "g++"}
VARIABLE = {"c": "CC", "c++": "CXX"}
Fake = Callable[..., Path]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test's own; the folder of the libraries in it."""
    for name in ("CC", "CXX"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TRIMTAB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("trimtab.compiler.native.cache._private_folders", [])
    monkeypatch.setattr("trimtab.compiler.native.cache._folder_problems", [])
    return tmp_path / "cache" / "c"


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fake:
    """Make CC or CXX a script: `always` runs at each call, `program` only for a program; then the real one.

    In both, $REAL is the real compiler, and each call adds its arguments as a line to $0.log.
    """

    def make(program: str = "", always: str = "", language: str = "c") -> Path:
        real = shutil.which(REAL[language])
        if real is None:
            pytest.skip(f"no {REAL[language]} here")
        script = tmp_path / f"my-{REAL[language]}"
        lines = [
            "#!/bin/sh",
            f"REAL={shlex.quote(real)}",
            'echo "$*" >>"$0.log"',
            always,
            f'case "$*" in *" program.c"*) :\n{program}\n;; esac',
            'exec "$REAL" "$@"',
        ]
        script.write_text("\n".join(lines) + "\n")
        script.chmod(0o755)
        monkeypatch.setenv(VARIABLE[language], str(script))
        return script

    return make


@pytest.fixture
def elsewhere() -> Callable[..., subprocess.Popen[str]]:
    """Start Python text in another process, with this one's environment and paths."""

    def start(text: str, *before: str) -> subprocess.Popen[str]:
        surroundings = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [*before, sys.executable, "-c", text]
        return subprocess.Popen(
            command,
            env=surroundings,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            stdin=subprocess.DEVNULL,
        )

    return start

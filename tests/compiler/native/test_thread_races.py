"""Threads of compiled programs under ThreadSanitizer: a batch of flights, a function in lanes; and a race it sees."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.sanitizer, pytest.mark.thorough]
FOUND = 66
"""The exit status where it found a race."""

FLIGHTS = """
from trimtab.run.simulate import simulate_batch
from trimtab.scenarios.build import build
simulate_batch(build("hovercraft/spin"), seeds=range(40), threads=4, backend="c")
"""
LANES = """
import numpy as np
import trimtab
compiled = trimtab.compile(lambda x: (np.float64(2) * x).sum(), np.zeros(50), lanes=8, threads=4)
assert (np.asarray(compiled.lanes(np.ones((400, 50)))) == 100).all()
"""
RACE = """
from trimtab.compiler.native.build import build_library, load_library
text = '''#include <pthread.h>
static int many;
static void *count(void *_) { for (int k = 0; k < 1000; ++k) ++many; return _; }
int race(void)
{
    pthread_t one, two;
    pthread_create(&one, 0, count, 0); pthread_create(&two, 0, count, 0);
    pthread_join(one, 0); pthread_join(two, 0);
    return many;
}'''
load_library(build_library(text, extra=("-pthread",))).race()
"""


def run(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Python with ThreadSanitizer in it; what trimtab compiles is instrumented, Python and its libraries are not."""
    where = subprocess.run(["gcc", "-print-file-name=libtsan.so"], capture_output=True, text=True).stdout.strip()
    environment = {
        **os.environ,
        "CC": "gcc -fsanitize=thread -g",
        "LD_PRELOAD": where,
        "TSAN_OPTIONS": f"exitcode={FOUND} ignore_noninstrumented_modules=1 report_signal_unsafe=0",
        "TRIMTAB_CACHE": str(folder),
    }
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def usable(tmp_path_factory):
    if shutil.which("gcc") is None:
        pytest.skip("no gcc here")
    tried = run("print(1)", tmp_path_factory.mktemp("cache"))
    if tried.stdout != "1\n":
        pytest.skip(f"ThreadSanitizer does not run here: {tried.stderr[:200]}")


def test_sanitizer_detects_a_deliberate_race(usable, tmp_path):
    ended = run(RACE, tmp_path)
    assert ended.returncode == FOUND, ended.stderr
    assert "data race" in ended.stderr


@pytest.mark.parametrize("script", [FLIGHTS, LANES], ids=["flights", "lanes"])
def test_compiled_programs_have_no_race(usable, script, tmp_path):
    ended = run(script, tmp_path)
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert "ThreadSanitizer" not in ended.stderr

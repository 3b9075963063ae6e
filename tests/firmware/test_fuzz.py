"""Garbage, damaged, unsigned, forged and replayed frames under the address and undefined-behaviour sanitizers."""

import subprocess

import pytest

pytestmark = pytest.mark.sanitizer


@pytest.mark.parametrize(
    ("seed", "size"),
    [
        (1, 10**6),
        pytest.param(2, 10**7, marks=pytest.mark.thorough),
        pytest.param(3, 10**7, marks=pytest.mark.thorough),
    ],
)
def test_accepts_every_valid_frame_and_rejects_all_others(fuzzer, seed, size):
    done = subprocess.run([fuzzer, str(seed), str(size)], capture_output=True, text=True, timeout=200)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr

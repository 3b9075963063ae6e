"""Templates of `trimtab new`: their tests pass, and fail if the part is wrong."""

import importlib
import subprocess
import sys

import pytest

from trimtab.commands.new import KINDS, main_file, read_files
from trimtab.compiler.native.compiler import find_compiler

SLIPS = {
    "vehicle": ("jnp.sin(x.lean) - ", "jnp.sin(x.lean) + "),
    "law": ("self.k_heading * off +", "-self.k_heading * off +"),
    "sensor": ("normal2(state, 0, 2)", "normal2(state, k, 2)"),
    "estimator": ("share * (z.yaw_rate - x.yaw_rate)", "share * z.yaw_rate"),
    "link": ("luck < self.loss", "luck > self.loss"),
    "actuator": ("jnp.exp(-dt / self.time_constant)", "(1 - dt / self.time_constant)"),
    "scenario": ('mass = "2.8 kg"', 'mass = "28 kg"'),
}
"""Kind -> a slip that somebody could make when they change the file."""


@pytest.mark.thorough("sensor", "scenario", "estimator", "link", "law")
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("kind", KINDS)
def test_template_passes_its_own_tests(kind):
    module = importlib.import_module(f"trimtab.templates.test_my_{kind}")
    tests = [test for name, test in vars(module).items() if name.startswith("test_")]
    assert len(tests) >= 2
    for test in tests:
        test()


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
@pytest.mark.parametrize("kind", KINDS)
def test_template_tests_detect_an_injected_error(kind, tmp_path):
    files = read_files(kind, "own")
    old, new = SLIPS[kind]
    main = main_file(kind).replace(f"my_{kind}", "own")
    assert old in files[main]
    files[main] = files[main].replace(old, new)
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    words = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "test_own.py")
    done = subprocess.run([sys.executable, *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "AssertionError" in done.stdout

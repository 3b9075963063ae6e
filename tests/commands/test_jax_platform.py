"""The commands compute on the CPU unless the user asks for a GPU; a platform that JAX lacks is an error in words."""

import os
import subprocess
import sys

import jax
import pytest
from click.testing import CliRunner

from trimtab.cli import VERBS, main
from trimtab.commands.jax_platform import VARIABLES, choose_platform

NO_CUDA = AssertionError()
NO_GPU = RuntimeError("Unknown backend: 'gpu' requested\n\nPlatforms present are: cpu")


@pytest.fixture(autouse=True)
def no_platform(monkeypatch):
    """Unset both variables, and restore them after the test."""
    for name in VARIABLES:
        monkeypatch.setenv(name, "")


def lacks_platform(monkeypatch, error):
    def devices():
        raise error

    monkeypatch.setattr(jax, "devices", devices)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_rejects_missing_platform(verb, monkeypatch):
    lacks_platform(monkeypatch, NO_CUDA)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    done = CliRunner().invoke(main, [verb])
    assert done.exit_code == 2, done.output
    refusal = "error: JAX_PLATFORMS=cuda: JAX cannot compute on this platform.\nFix: JAX_PLATFORMS=cpu to compute "
    assert done.stderr.startswith(refusal)
    assert "jax[cuda12]" in done.stderr


def test_reports_first_line_of_reason(monkeypatch):
    lacks_platform(monkeypatch, NO_GPU)
    monkeypatch.setenv("JAX_PLATFORM_NAME", "gpu")
    done = CliRunner().invoke(main, ["list"])
    assert done.exit_code == 2
    assert "JAX_PLATFORM_NAME=gpu: JAX cannot compute on this platform: Unknown backend: 'gpu' requested" in done.stderr
    assert "Platforms present" not in done.stderr


@pytest.mark.parametrize("value", ["", "cpu"])
def test_cpu_needs_no_check(value, monkeypatch):
    lacks_platform(monkeypatch, NO_CUDA)
    monkeypatch.setenv("JAX_PLATFORMS", value)
    choose_platform(["run", "hovercraft/spin"])


def test_accepts_platform_that_jax_has(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cuda,cpu")
    choose_platform(["run", "hovercraft/spin"])
    assert os.environ["JAX_PLATFORMS"] == "cuda,cpu"


@pytest.mark.parametrize(
    ("words", "platform"),
    [
        (["run", "hovercraft/spin"], "cpu"),
        (["campaign", "hovercraft/spin", "--device", "cpu"], "cpu"),
        (["campaign", "hovercraft/spin", "--device", "gpu"], ""),
        (["campaign", "hovercraft/spin", "--device=gpu"], ""),
    ],
)
def test_selects_cpu_unless_gpu_is_asked_for(words, platform, monkeypatch):
    monkeypatch.delitem(sys.modules, "jax")
    choose_platform(words)
    assert os.environ["JAX_PLATFORMS"] == platform


def test_keeps_platform_if_jax_is_already_imported():
    choose_platform(["run", "hovercraft/spin"])
    assert os.environ["JAX_PLATFORMS"] == ""


@pytest.mark.thorough
@pytest.mark.parametrize("value", ["cuda", "gpu", "nonsense"])
def test_unavailable_platform_is_rejected_by_real_jax(value):
    words = [sys.executable, "-m", "trimtab", "run", "hovercraft/spin"]
    done = subprocess.run(words, env=os.environ | {"JAX_PLATFORMS": value}, capture_output=True, text=True)
    if done.returncode == 0 and value != "nonsense":
        pytest.skip("this machine has a GPU")
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: JAX_PLATFORMS={value}: JAX cannot compute on this platform")
    assert "Traceback" not in done.stderr

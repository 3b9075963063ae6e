"""CI has XLA build loops in its older way, which compiles in half the time: results are the same but for rounding."""

import jax
import numpy as np
import pytest
from xla_settings import HAS_OLDER, choose_emitters

from contracts.parts import example, made, rollout
from trimtab.actuators.drive import FanDrive
from trimtab.laws.stable_inversion import StableInversion
from trimtab.links.wire import DelayChain
from trimtab.sensors.imu import Imu

PARTS = (("sensors", Imu), ("links", DelayChain), ("laws", StableInversion), ("actuators", FanDrive))


@pytest.mark.thorough
@pytest.mark.skipif(not HAS_OLDER, reason="this JAX has the newer emitters only")
@pytest.mark.parametrize(("folder", "cls"), PARTS, ids=[cls.__name__ for _, cls in PARTS])
def test_old_and_new_xla_emitters_give_equal_results(folder, cls):
    """XLA's default is the newer kind; tests/conftest.py sets the older one for all tests and pages.

    Measured: bits are the same but for the noise of the Imu, which differs by 9.5e-16 of itself at most.
    """
    one = made(cls)
    given = example(folder, one)
    lowered = jax.jit(lambda one, run: rollout(folder, one, given, run, 40)).lower(one, np.uint32(1))
    results = []
    for newer in (True, False):
        compiled = lowered.compile(compiler_options=choose_emitters(newer))
        results.append(jax.tree.leaves(compiled(one, np.uint32(1))))
    for newer, older in zip(*results, strict=True):
        np.testing.assert_allclose(older, newer, rtol=8 * np.finfo(float).eps, atol=0)

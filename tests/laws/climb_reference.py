"""The large climb, the bounded internal states along it, and how to run a form of them."""

import functools
import time

import jax
import numpy as np

from trimtab.core.record import FAST_COMPILE_OPTIONS, to_arrays
from trimtab.laws.path_command import FilteredClimb
from trimtab.scenarios.hypersonic import _internal
from trimtab.vehicles.hypersonic import Hypersonic

CRAFT = to_arrays(Hypersonic())
CLIMB = to_arrays(FilteredClimb(dh=5000.0, dV=1000.0))
H0, V0 = 85000.0, 7702.0808
SCALES, DT, SECONDS = np.array([1e-2, 1e-2, 1.0, 10.0, 1.0, 10.0]), 0.005, 60.0
T = DT * np.arange(round(SECONDS / DT))


@functools.cache
def noncausal():
    """Table and report of the large climb, and how long it took (s)."""
    begin = time.perf_counter()
    table, report = _internal.noncausal_table(CRAFT, CLIMB, SECONDS)
    return table, report, time.perf_counter() - begin


@functools.cache
def linear():
    """Return the same from the linearisation at the start."""
    return _internal.linear_table(CRAFT, CLIMB, SECONDS)


def run(form, climb=CLIMB, every=1):
    """Return the last state of a form, and zeta_d (n, 6) at each of T[::every]."""
    steps = jax.jit(lambda form, climb: _scanned(form, climb, T[::every]), compiler_options=FAST_COMPILE_OPTIONS)
    state, zeta = steps(to_arrays(form), climb)
    return state, np.asarray(zeta)


def _scanned(form, climb, t):
    return jax.lax.scan(lambda state, t: form.step(t, state, climb), form.init(None), t)


def miss(zeta, reference, every=1):
    """Return the largest scaled difference of each coordinate (6,)."""
    return np.abs((zeta - reference[: len(T) : every]) / SCALES).max(axis=0)

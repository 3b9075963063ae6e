"""Stability proof of the hypersonic vehicle's complete loop: sampled, for uncertain plants, and within input limits.

The plant is the simulated vehicle. It may differ from the vehicle model of law and filter in its coefficients
(UNCERTAINTY) or in its bending modes. Each of these two sets of plants is a box in the space of parameters in which
the loop's matrix is affine, see `_loop.continuous_loop`.

Source: [1] "Angular-accelerometer-based flexible-state estimation and tracking controller design for hypersonic flight
vehicle", Aerospace 2022, 9(4), 206, assumptions 1 and 2. The paper contains no such proof. The sizes of the boxes are
our choice.
"""

import itertools
import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np

from trimtab.core.record import replace, with_leaf
from trimtab.core.time import to_seconds
from trimtab.design.certificate import Certificate, ObserverPart
from trimtab.design.certified_system import LoopLines
from trimtab.design.loop_proof import prove_boxes, prove_level, prove_sampled
from trimtab.design.proof import Line, ProofCondition
from trimtab.estimators.flexible.discrete import FlexibleModeFilter
from trimtab.laws.path_inversion import InputLimits
from trimtab.scenarios.hypersonic._internal import LevelTrim
from trimtab.scenarios.hypersonic._loop import (
    INTEGRAL_SIZES,
    INTEGRALS,
    SAMPLED,
    SAMPLED_SIZES,
    continuous_loop,
    input_slope,
    sampled_loop,
)
from trimtab.vehicles.hypersonic import Hypersonic

UNCERTAINTY = {
    "m": 0.02,
    "forces.aerodynamics.CL_a": 0.05,
    "forces.aerodynamics.CM_a": 0.05,
    "forces.aerodynamics.CD_0": 0.10,
    "forces.propulsion.b7": 0.05,
}
"""Uncertain coefficient of the plant -> maximum relative error in either direction. The plant of the scenario
hypersonic/mismatch is one corner of this box."""
DAMPING_ERROR, MODAL_STEP, LEAST_DECAY = 0.1, 0.01, 0.01
"""Parameters of the proof.

DAMPING_ERROR: maximum relative error of the damping 2 zeta w of the plant's modes, in either direction. MODAL_STEP:
relative half width of one box of modal frequencies. LEAST_DECAY: decay rate that is proved for every plant (1/s).
"""
FLOWN_FILTERS = {
    "tuned": FlexibleModeFilter(),
    "equal": FlexibleModeFilter.with_equal_noise(),
    "accurate": FlexibleModeFilter.for_exact_model(),
    "printed": FlexibleModeFilter.from_publication(),
}
"""Filters that estimate the bending modes in flight, by name."""


def prove_loop(craft: Hypersonic, at: LevelTrim, filter: str, uncertainty: float, mode_error: float) -> LoopLines:
    """Return a function that yields the conditions of the proof: for the sampled loop, and for the plants of both
    boxes.

    Args:
        craft: vehicle model of law and filter.
        at: level flight at which the loop is linearised.
        filter: name of a filter in FLOWN_FILTERS.
        uncertainty: size of the coefficients' box, as a multiple of UNCERTAINTY.
        mode_error: maximum relative error of the modal frequencies.
    """

    @lru_cache(maxsize=4)
    def prove_one(K: bytes) -> ProofCondition:
        kept = replace(FLOWN_FILTERS[filter], craft=craft)
        F, _ = sampled_loop(craft, kept, np.frombuffer(K).reshape(2, -1), at)
        more = len(F) - len(SAMPLED)
        size = np.append(SAMPLED_SIZES, INTEGRAL_SIZES[:more])
        return prove_sampled(F, size, to_seconds(kept.period), (*SAMPLED, *INTEGRALS[:more]))

    @lru_cache(maxsize=4)
    def box(modal: bool, K: bytes, L: bytes) -> ProofCondition:
        gains = np.frombuffer(K).reshape(2, -1), np.frombuffer(L).reshape(4, 1)
        boxes = _modal_boxes(craft, mode_error) if modal else [_coefficient_box(craft, uncertainty)]
        loops = [np.array([continuous_loop(plant, craft, *gains, at) for plant in plants]) for plants in boxes]
        more = gains[0].shape[1] - 9
        size = np.append(SAMPLED_SIZES[:13], INTEGRAL_SIZES[:more])
        condition = prove_boxes(loops, size, LEAST_DECAY, (*SAMPLED[:13], *INTEGRALS[:more]))
        errors = f"w1, w2 {100 * mode_error:g} %, 2 zeta w {100 * DAMPING_ERROR:g} %"
        errors = errors if modal else describe_uncertainty(uncertainty)
        return condition._replace(why=f"{errors}{'; ' if condition.why else ''}{condition.why}")

    def lines(c: Any) -> Iterator[Line]:
        gains = np.ascontiguousarray(c.K).tobytes(), np.ascontiguousarray(c.observer.L).tobytes()
        yield "inside a level of V no input saturates", lambda: _level_condition(craft, at, c, c.observer)
        yield "the sampled loop decays", lambda: prove_one(gains[0])
        yield "every plant of the modes' box decays", lambda: box(True, *gains)
        yield "every plant of the coefficients' box decays", lambda: box(False, *gains)

    return lines


def _level_condition(craft: Hypersonic, at: LevelTrim, c: Certificate, o: ObserverPart) -> ProofCondition:
    low, high = (np.array(bound, float) for bound in InputLimits().bounds())
    rest = np.array([at.u.Phi, at.u.delta_e])
    return prove_level(c, o, input_slope(craft, c.K, at), np.minimum(rest - low, high - rest))


def _coefficient_box(craft: Hypersonic, uncertainty: float) -> list[Hypersonic]:
    """Return the plants at the corners of the box of coefficients. uncertainty: factor on the box UNCERTAINTY."""
    corners = itertools.product((-1.0, 1.0), repeat=len(UNCERTAINTY))
    return [uncertain_plant(craft, tuple(uncertainty * part for part in corner)) for corner in corners]


def _modal_boxes(craft: Hypersonic, error: float) -> Iterator[list[Hypersonic]]:
    """Yield boxes of the modal parameters (w1^2, w2^2, 2 zeta1 w1, 2 zeta2 w2) that cover the errors of the modes.

    Each box is a list of the plants at its corners. The range of the frequencies is divided into several boxes, but the
    range of the damping is not divided. error: maximum relative error of the frequencies.
    """
    modes, count = craft.modes, max(1, math.ceil(error / MODAL_STEP))
    edges = np.linspace((1 - error) ** 2, (1 + error) ** 2, count + 1)
    damping = ((1 - error) * (1 - DAMPING_ERROR), (1 + error) * (1 + DAMPING_ERROR))
    for i, j in itertools.product(range(count), repeat=2):
        plants = []
        for a, b, c1, c2 in itertools.product(edges[i : i + 2], edges[j : j + 2], damping, damping):
            w1, w2 = modes.w1 * math.sqrt(a), modes.w2 * math.sqrt(b)
            zeta1, zeta2 = modes.zeta1 * c1 / math.sqrt(a), modes.zeta2 * c2 / math.sqrt(b)
            plants.append(replace(craft, modes=replace(modes, w1=w1, w2=w2, zeta1=zeta1, zeta2=zeta2)))
        yield plants


def describe_uncertainty(uncertainty: float) -> str:
    """Return a text that lists each uncertain coefficient with its maximum relative error."""
    return ", ".join(f"{p.rpartition('.')[2]} {100 * part * uncertainty:g} %" for p, part in UNCERTAINTY.items())


def uncertain_plant(craft: Hypersonic, parts: Any) -> Hypersonic:
    """Return the vehicle with changed coefficients.

    parts: changes (5,) of the coefficients in UNCERTAINTY, each as a fraction of the coefficient's maximum error.
    """
    for (path, share), part in zip(UNCERTAINTY.items(), parts, strict=True):
        craft = with_leaf(craft, path, lambda old, _, factor=1 + share * part: old * factor)
    return craft

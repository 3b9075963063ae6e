"""Weights from stated limits (Bryson's rule), and the certified system of a linear model with these weights.

Bryson's rule: every state and input at its limit has the same cost,

    Q = diag(1/limit(x)^2)        R = diag(1/limit(u)^2)

Source: A. E. Bryson, Y.-C. Ho, "Applied optimal control", Hemisphere 1975, section 5.2.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, argument, argument_name
from trimtab.design.certified_system import CertifiedSystem, Setting
from trimtab.design.linearise import LinearModel
from trimtab.design.lqr import augment_integrals
from trimtab.design.model import find_indices

STRICT = 1.01
"""Ratio of the regulator's weight Q to the certified weight Q_e. `trimtab design hypersonic` uses the same ratio."""
INTEGRAL = "integral of "


def weigh_by_limits(
    name: str,
    linear: LinearModel,
    limits: Mapping[str, float],
    integrals: Mapping[str, float] | None = None,
    about: Mapping[str, Setting] | None = None,
) -> CertifiedSystem:
    """Build the system with Bryson's weights, for which `certificate.design_certificate` designs a gain.

    Args:
        name: name of the vehicle.
        linear: linear model at a trim, with the states that are fed back.
        limits: largest acceptable value of each state and input. A larger value means a lower weight.
        integrals: state -> limit of the integral of the state's error. These integrals are appended to the states.
        about: settings and operating point, stored in the certificate, so that the system can be built again.

    Source: Bryson and Ho, as above.
    """
    integrals = integrals or {}
    find_indices(argument_name("limits"), limits, (*linear.states, *linear.inputs))
    rows = find_indices(argument_name("integrals"), integrals, linear.states)
    lacking = [n for n in (*linear.inputs, *linear.states) if n not in limits]
    if lacking:
        words = " ".join(argument("limits", "NUMBER", n) for n in lacking)
        raise InputError(
            argument_name("limits"),
            f"no limit is given for {', '.join(lacking)}",
            fix=f"{words}  (the largest acceptable value)",
        )
    _check_limits({**limits, **{f"{INTEGRAL}{n}": v for n, v in integrals.items()}})
    A, B = augment_integrals(linear.A, linear.B, rows)
    sizes = np.array([*(limits[n] for n in linear.states), *integrals.values()], float)
    Q = np.diag(1 / sizes**2)
    return CertifiedSystem(
        name=name,
        about=dict(about or {}),
        method="lqr",
        states=(*linear.states, *(f"{INTEGRAL}{n}" for n in integrals)),
        inputs=linear.inputs,
        A=A,
        B=B,
        Qe=Q / STRICT,
        Re=np.diag([1 / limits[n] ** 2 for n in linear.inputs]),
        Q=Q,
        scale=sizes,
    )


def fed_back_states(linear: LinearModel, idle: Iterable[str], named: Iterable[str]) -> tuple[str, ...]:
    """Return the states that are fed back: the states that are not idle, and the idle states in `named`."""
    left_out = set(idle) - set(named)
    return tuple(n for n in linear.states if n not in left_out)


def _check_limits(limits: Mapping[str, Any]) -> None:
    for name, value in limits.items():
        if not 0 < value < np.inf:
            raise InputError(
                argument_name("limits", name),
                f"must be finite and above 0, got {value}",
                fix="give the largest acceptable value, e.g. 0.1",
            )

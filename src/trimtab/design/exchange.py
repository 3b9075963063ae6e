"""Conversion of linear models and compensators to and from python-control and scipy.

`to_control` and `from_control` need python-control, from the extra `control`; scipy is always installed.

Source: R. M. Murray and others, the Python Control Systems Library, python-control.org.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from trimtab.core.errors import InputError, install_command
from trimtab.design.linearise import LinearModel


def to_control(linear: LinearModel) -> Any:
    """Convert a linear model to python-control's `StateSpace`, with its signal names. Signals are deviations from the
    operating point."""
    names = {"states": list(linear.states), "inputs": list(linear.inputs), "outputs": list(linear.outputs)}
    return _import_control().ss(linear.A, linear.B, linear.C, linear.D, **names)


def to_scipy(linear: LinearModel) -> Any:
    """Convert a linear model to scipy.signal's `StateSpace`. The names of the signals are lost."""
    from scipy.signal import StateSpace

    return StateSpace(linear.A, linear.B, linear.C, linear.D)


def from_control(system: Any) -> LinearModel:
    """Convert a continuous system of python-control (state space, transfer function) or scipy.signal to a linear model.

    The result's operating point is zero. Signals keep their python-control names, if any. Otherwise they are named x0,
    x1, …, u0, …, y0, ….

    Raises: InputError for a sampled system, or an object of another type.
    """
    A, B, C, D, dt = system_matrices(system)
    if dt:
        fix = "give the continuous system; compensator_law accepts a sampled compensator"
        raise InputError("from_control", f"the system must be continuous, but is sampled every {dt} s", fix=fix)
    n, m, p = len(A), B.shape[1], len(C)
    states = _labels(system, "state_labels", "x", n)
    inputs, outputs = _labels(system, "input_labels", "u", m), _labels(system, "output_labels", "y", p)
    zeros = (np.zeros(n), np.zeros(m), np.zeros(p), np.zeros(n))
    return LinearModel(A, B, C, D, *zeros, states, inputs, outputs)


def system_matrices(system: Any) -> tuple[Any, Any, Any, Any, float]:
    """Return A, B, C, D and the sampling period (s, 0 if continuous) of a system of python-control or scipy.signal."""
    if not all(hasattr(system, n) for n in "ABCD"):
        if hasattr(system, "to_ss"):  # scipy.signal
            system = system.to_ss()
        elif type(system).__module__.partition(".")[0] == "control":
            system = _import_control().ss(system)
        else:
            problem = f"a {type(system).__name__} is not a system of python-control or scipy.signal"
            raise InputError("system", problem, fix="give control.ss(A, B, C, D), or scipy.signal.StateSpace")
    matrices = [np.atleast_2d(np.asarray(getattr(system, n), float)) for n in "ABCD"]
    n = 0 if matrices[0].size == 0 else len(matrices[0])
    p, m = matrices[3].shape
    A, B, C, D = (M.reshape(shape) for M, shape in zip(matrices, ((n, n), (n, m), (p, n), (p, m)), strict=True))
    if not all(np.isfinite(M).all() for M in (A, B, C, D)):
        raise InputError("system", "all entries of A, B, C and D must be finite", fix="give finite numbers")
    dt = getattr(system, "dt", None)
    return A, B, C, D, 0.0 if dt is None or dt is False else float(dt)


def discrete_matrices(system: Any, period: float) -> tuple[Any, Any, Any, Any]:
    """Return A, B, C, D of a compensator that steps every `period` (s). A continuous compensator is converted by
    Tustin's rule.

    Raises: InputError for a sampled compensator with another period.
    """
    from scipy.signal import cont2discrete

    A, B, C, D, dt = system_matrices(system)
    if dt and not np.isclose(dt, period, rtol=1e-9):
        raise InputError(
            "compensator",
            f"the compensator's period must be that of the loop, {period} s, got {dt} s",
            fix=f"give period={dt}, or a continuous compensator",
        )
    if dt or not len(A):
        return A, B, C, D
    sampled: Any = cont2discrete((A, B, C, D), period, method="bilinear")
    return sampled[:4]


def _labels(system: Any, what: str, letter: str, count: int) -> tuple[str, ...]:
    own: Sequence[str] | None = getattr(system, what, None)
    return tuple(own) if own is not None and len(own) == count else tuple(f"{letter}{i}" for i in range(count))


def _import_control() -> Any:
    try:
        import control
    except ModuleNotFoundError as error:
        if error.name != "control":
            raise
        raise InputError("python-control", "the package is not installed", fix=install_command("control")) from None
    return control

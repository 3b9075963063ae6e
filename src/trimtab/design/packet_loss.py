"""How lost packets spread a signal: the mean square of x under control over a link that drops packets.

    x(k+1) = w(k) where the packet came,  a x(k) + w(k) where it was lost;   w white, of variance 1

Control that arrives takes x away within one step; with loss the step runs open. A packet is sent again up to
`retransmissions` times within its step, each try lost with probability q: with one retransmission the step is lost with
q^2, and E x^2 stays bounded where |a| q < 1.

Source: [1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, section
5.3.3, eqs. 5.2 and 5.3. The number of retransmissions is free here; [1] has one.
"""

from typing import Any

import numpy as np

from trimtab.core.errors import InputError


def growth(a: Any, q: Any, *, retransmissions: int = 1) -> Any:
    """What E x^2 is multiplied by from one step to the next: a^2 q^(1 + retransmissions); bounded where below 1.

    Args:
        a: the plant's pole, per step; any shape.
        q: probability that one try is lost, in [0, 1]; of a shape that fits a's.
        retransmissions: tries after the first.
    """
    a, q = np.asarray(a, float), np.asarray(q, float)
    if not (np.isfinite(a).all() and ((q >= 0) & (q <= 1)).all()):
        raise InputError("packet_loss", f"a = {a}, q = {q}", fix="give a finite pole, and q in [0, 1]")
    if retransmissions < 0 or retransmissions != int(retransmissions):
        raise InputError("packet_loss", f"{retransmissions!r} retransmissions", fix="give a whole number, 0 or more")
    return a**2 * q ** (1 + retransmissions)


def mean_squares(a: float, q: float, steps: int, *, start: float = 0.0, retransmissions: int = 1) -> Any:
    """E x^2 after 0, 1, …, `steps` steps (steps + 1,): E x(k+1)^2 = growth E x(k)^2 + 1, exact at every step.

    Args:
        a: the plant's pole, per step.
        q: probability that one try is lost.
        steps: how many.
        start: E x(0)^2.
        retransmissions: tries after the first.
    """
    g = float(growth(a, q, retransmissions=retransmissions))
    found = np.empty(steps + 1)
    found[0] = start
    for k in range(steps):
        found[k + 1] = g * found[k] + 1
    return found


def mean_square(a: Any, q: Any, *, retransmissions: int = 1) -> Any:
    """The limit of E x^2, 1/(1 - a^2 q^2) with one retransmission; infinite where there is none [1, eq. 5.3]."""
    g = growth(a, q, retransmissions=retransmissions)
    return np.where(g < 1, 1 / np.where(g < 1, 1 - g, 1.0), np.inf)


def critical_loss(a: Any, *, retransmissions: int = 1) -> Any:
    """The probability q of a lost try from which on E x^2 grows without bound: 1/|a| with one retransmission.

    1 for plants that are stable by themselves: no loss spreads them.
    """
    size = np.maximum(np.abs(np.asarray(a, float)), 1.0)
    return size ** (-2.0 / (1 + retransmissions))

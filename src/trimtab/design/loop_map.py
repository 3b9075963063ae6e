"""Periodic linear map of a loop: poles, response of the loop opened at a command, and margins of gain and delay.

    z(j+1) = A_j z(j) + B_j v(j)        c(j) = C_j z(j)        j = 0 … N-1, then again

v = c closes the loop. Poles are those of the map over one period. Margins are the gain between c and v, or the delay in
whole instants, that the loop tolerates. The margins are computed exactly from the poles. The response is that of the
fundamental: the component exp(jwt) of c(t) for v(t) = exp(jwt). Components that sampling aliases to other frequencies
are left out. `run.loop_linearisation` computes the map of a scenario.

Source: [1] S. Bittanti, P. Colaneri, "Periodic systems", Springer 2009, chapters 2 and 3; for aliasing [2] K. J.
Åström, B. Wittenmark, "Computer-controlled systems", Prentice Hall 1997, chapter 7.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError

DEADBEAT = 1e-6
"""Magnitude below which a pole of the map over one period counts as zero. The state of such a pole is cleared within
the period."""
ROUNDING = 1e-12
"""Magnitude below which a pole counts as zero if the period has more than four instants per state, which is long enough
to clear all memory."""
STABLE = 1e-6
"""Largest excess of a pole's magnitude over 1 at which a loop counts as stable."""


class LoopMap(NamedTuple):
    """Linear map of a loop over one period: matrices A_j (N, n, n), B_j (N, n, m), C_j (N, m, n).

    Data in transit are states, with the same indices in every matrix.  tick: time between instants (s).  states: names
    of z (n,).  commands: names of c.  idle (n,): True for states on which no command depends, e.g. a position or a
    clock.  slowest: period of the loop's slowest component (s).
    """

    A: Any
    B: Any
    C: Any
    tick: float
    states: tuple[str, ...]
    commands: tuple[str, ...]
    idle: Any
    slowest: float

    @property
    def period(self) -> float:
        """Period T = N tick (s) of the loop, after which the matrices repeat."""
        return self.tick * len(self.A)

    def transition(self, gain: Any = 1.0, delay: int = 0) -> Any:
        """Return the matrix of the closed loop over one period, for non-idle states and commands in transit.

        Args:
            gain: factor v/c: one number for all commands, or one for each command (m,).
            delay: number of instants between c and v.
        """
        keep = ~self.idle
        n, m = int(keep.sum()), self.B.shape[2]
        g = np.broadcast_to(np.asarray(gain, float), (m,))
        whole = np.eye(n + m * delay)
        for A, B, C in zip(self.A[:, keep][:, :, keep], self.B[:, keep], self.C[:, :, keep], strict=True):
            z, line = whole[:n], whole[n:]
            c = C @ z
            v = line[:m] if delay else c
            line = np.concatenate([line[m:], c]) if delay else line
            whole = np.concatenate([A @ z + B @ (g[:, None] * v), line])
        return whole

    def poles(self) -> Any:
        """Return the closed loop's eigenvalues over one period, by falling magnitude, without idle states."""
        poles = np.linalg.eigvals(self.transition())
        return poles[np.lexsort((-poles.imag, -np.abs(poles).round(12)))]

    @property
    def deadbeat(self) -> float:
        """Magnitude below which a pole of the discrete-time map over one period counts as zero."""
        return ROUNDING if len(self.A) > 4 * int((~self.idle).sum()) else DEADBEAT

    def growth(self, gain: Any = 1.0, delay: int = 0) -> float:
        """Return the magnitude of the largest pole of the map over one period. Below 1, the loop is stable."""
        return float(np.abs(np.linalg.eigvals(self.transition(gain, delay))).max(initial=0.0))

    def response(self, w: Any) -> Any:
        """Return the loop's frequency response -c/v at frequencies w (rad/s), complex (k, m, m), for negative feedback
        as in `loop_transfer`."""
        keep = ~self.idle
        A, B, C = self.A[:, keep][:, :, keep], self.B[:, keep], self.C[:, :, keep]
        n, m, N = A.shape[1], B.shape[2], len(A)
        values = []
        for frequency in np.atleast_1d(np.asarray(w, float)):
            turn = np.exp(1j * frequency * self.tick * np.arange(N))
            whole, driven = np.eye(n), np.zeros((n, m), complex)
            states, drives = [], []
            for j in range(N):
                states.append(C[j] @ whole)
                drives.append(C[j] @ driven)
                whole, driven = A[j] @ whole, A[j] @ driven + B[j] * turn[j]
            z0 = np.linalg.solve(np.exp(1j * frequency * self.period) * np.eye(n) - whole, driven)
            c = [(s @ z0 + d) / t for s, d, t in zip(states, drives, turn, strict=True)]
            values.append(-np.mean(c, axis=0))
        return np.array(values)

    def broken_loops(self, w: Any) -> Any:
        """Return -c/v of each command, with only this command's loop opened, at frequencies w (rad/s): complex (k,
        m)."""
        whole = self.response(w)
        columns = []
        for i in range(whole.shape[1]):
            others = [j for j in range(whole.shape[1]) if j != i]
            rest = np.eye(len(others)) + whole[:, others][:, :, others]
            back = np.linalg.solve(rest, whole[:, others][:, :, [i]])
            columns.append(whole[:, i, i] - (whole[:, [i]][:, :, others] @ back)[:, 0, 0])
        return np.stack(columns, axis=1)

    def grid(self) -> Any:
        """Return frequencies (rad/s) from a tenth of the slowest pole to half the sampling rate of the slowest
        component."""
        high = math.pi / self.slowest
        slow = [abs(s) for s in self.continuous_poles() if abs(s) > 1e-6 * high]
        return np.geomspace(min(slow, default=1e-3 * high) / 10, high, 400)

    def continuous_poles(self) -> Any:
        """Return the equivalent continuous poles log(pole)/T (1/s) of the non-zero poles."""
        poles = self.poles()
        poles = poles[np.abs(poles) > self.deadbeat].astype(complex)
        return np.log(poles) / self.period


class LoopMargins(NamedTuple):
    """Margins of a loop, from its poles.

    gain_up, gain_down: largest and smallest factor on all commands for which the loop is stable (infinite or 0 if
    stability has no limit).  delay: largest tolerated delay of the commands (s), a whole number of instants; inf if the
    longest delay tried is tolerated.  crossings: command -> crossover frequencies (rad/s) and phase margins (rad) of
    the fundamental, with only this command's loop opened.
    """

    gain_up: float
    gain_down: float
    delay: float
    crossings: dict[str, tuple[tuple[float, float], ...]]


def loop_margins(loop: LoopMap, *, longest: float = 1.0) -> LoopMargins:
    """Compute gain and delay margins of a stable loop; raise InputError if the loop is unstable.

    Args:
        loop: map of the loop.
        longest: largest delay tried (s).
    """
    if loop.growth() > 1 + STABLE:
        problem = f"the loop is not stable: its motion grows by a factor of {loop.growth():.6g} in {loop.period:g} s"
        raise InputError("loop margins", problem, fix="change the gains, or shorten the delays")
    up = _bisect_gain(loop, 1.0, 1e3)
    down = _bisect_gain(loop, 1.0, 1e-3)
    most = math.ceil(longest / loop.tick)
    low, high = 0, 1
    while high <= most and loop.growth(delay=high) <= 1 + STABLE:
        low, high = high, 2 * high
    if high > most:
        return LoopMargins(up, down, math.inf, find_crossings(loop))
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if loop.growth(delay=middle) <= 1 + STABLE else (low, middle)
    return LoopMargins(up, down, low * loop.tick, find_crossings(loop))


def find_crossings(loop: LoopMap) -> dict[str, tuple[tuple[float, float], ...]]:
    """Return the crossover frequencies (rad/s) and phase margins (rad) of each command, with only this command's loop
    opened."""
    w = loop.grid()
    values = loop.broken_loops(w)
    crossings = {}
    for name, column in zip(loop.commands, values.T, strict=True):
        size, found = np.log(np.maximum(np.abs(column), 1e-300)), []
        for i in np.flatnonzero(np.sign(size[:-1]) * np.sign(size[1:]) < 0):
            part = size[i] / (size[i] - size[i + 1])
            at = float(w[i] * (w[i + 1] / w[i]) ** part)
            (there,) = loop.broken_loops([at])[:, loop.commands.index(name)]
            phase = (np.angle(there) + 2 * math.pi) % (2 * math.pi) - math.pi
            found.append((at, float(phase)))
        crossings[name] = tuple(found)
    return crossings


def _bisect_gain(loop: LoopMap, inside: float, outside: float) -> float:
    """Return the gain, between a stable and an outer factor, at which the loop becomes unstable.

    If the loop stays stable up to the outer factor, the result is infinite, or 0 for a falling gain.
    """
    steps = np.geomspace(inside, outside, 40)[1:]
    for last, factor in zip((inside, *steps[:-1]), steps, strict=True):
        if loop.growth(factor) > 1 + STABLE:
            low, high = float(last), float(factor)
            break
    else:
        return math.inf if outside > inside else 0.0
    for _ in range(40):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if loop.growth(middle) <= 1 + STABLE else (low, middle)
    return low

"""Linearisation by automatic differentiation, in deviations from a point, with the names of all entries kept.

Offline code: LAPACK.

Source: [1] B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft Control and Simulation", Wiley 2015, section 3.7.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.design.model import StateSpaceModel, find_indices
from trimtab.design.poles import balance_matrix, participation, sorted_poles

ROUNDING = 1e-10
"""Real and imaginary parts below this part of the largest entry of the scaled A count as zero."""
TOGETHER = 1e-6
"""Poles closer than this part of the largest entry of the scaled A have their states in common."""


class Eigenmode(NamedTuple):
    """One real pole, or a conjugate pair.

    pole: with positive imaginary part where it is a pair.  frequency: |pole| (rad/s).  damping: -Re/|pole|; nan at 0.
    time_constant: 1/|Re pole| (s), of decay or growth; infinite where neither.  states: name and participation of the
    states that make it, largest first; participations of a mode sum to 1 and do not depend on units.
    """

    pole: complex
    frequency: float
    damping: float
    time_constant: float
    states: tuple[tuple[str, float], ...]


class LinearModel(NamedTuple):
    """dx' = A dx + B du, dy = C dx + D du, deviations from (x0, u0, y0).

    A: (n, n).  B: (n, m).  C: (p, n).  D: (p, m).  x0, u0, y0: the point.  drift: f(x0, u0) (n,), zero at a trim.
    states, inputs, outputs: names.
    """

    A: Any
    B: Any
    C: Any
    D: Any
    x0: Any
    u0: Any
    y0: Any
    drift: Any
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def poles(self) -> Any:
        """Eigenvalues of A (n,), by falling real part."""
        return sorted_poles(balance_matrix(self.A))

    def modes(self, *, least: float = 0.02) -> tuple[Eigenmode, ...]:
        """Poles with their states, by falling real part; states with a participation below `least` are left out."""
        scaled = balance_matrix(self.A)
        size = max(np.abs(scaled).max(initial=0.0), np.finfo(float).tiny)
        modes: list[Eigenmode] = []
        for exact in sorted_poles(scaled):
            pole = complex(_drop_rounding(exact.real, size), _drop_rounding(exact.imag, size))
            if pole.imag < 0:
                continue
            share = participation(scaled, exact, TOGETHER * size)
            pairs = sorted(zip(self.states, share.tolist(), strict=True), key=lambda pair: -pair[1])
            states = tuple((n, s) for n, s in pairs if s >= least)
            frequency = abs(pole)
            damping = -pole.real / frequency if frequency else float("nan")
            slow = 1 / abs(pole.real) if pole.real else float("inf")
            modes.append(Eigenmode(pole, frequency, damping, slow, states))
        return tuple(modes)

    def table(self) -> str:
        """The modes as text, one a line."""
        lines = [f"{'pole [1/s]':>24}  {'rad/s':>9}  {'damping':>8}  {'time [s]':>9}  states"]
        for m in self.modes():
            pole = f"{m.pole.real:+.5g}" + (f" ± {m.pole.imag:.5g}i" if m.pole.imag else "")
            states = ", ".join(f"{n} {s:.2f}" for n, s in m.states)
            lines.append(f"{pole:>24}  {m.frequency:9.4g}  {m.damping:8.4f}  {m.time_constant:9.4g}  {states}")
        return "\n".join(lines)

    def part(
        self,
        states: Iterable[str] | None = None,
        inputs: Iterable[str] | None = None,
        outputs: Iterable[str] | None = None,
    ) -> "LinearModel":
        """The rows and columns of the named states, inputs and outputs, in that order; the others are held at zero."""
        i = find_indices(argument_name("states"), self.states if states is None else states, self.states)
        j = find_indices(argument_name("inputs"), self.inputs if inputs is None else inputs, self.inputs)
        k = find_indices(argument_name("outputs"), self.outputs if outputs is None else outputs, self.outputs)
        pairs = ((self.states, i), (self.inputs, j), (self.outputs, k))
        labels = (tuple(names[q] for q in places) for names, places in pairs)
        A, B, C, D = self.A[np.ix_(i, i)], self.B[np.ix_(i, j)], self.C[np.ix_(k, i)], self.D[np.ix_(k, j)]
        return LinearModel(A, B, C, D, self.x0[i], self.u0[j], self.y0[k], self.drift[i], *labels)

    def settle(self, states: Iterable[str]) -> "LinearModel":
        """The model without the named states, each at the value to which the others hold it: those that settle fast.

        Outputs keep their meaning; `x0` and `drift` are those of the states that stay.

        Raises: InputError where the named states do not settle by themselves.

        Source: P. V. Kokotovic, H. K. Khalil, J. O'Reilly, "Singular perturbation methods in control", Academic Press
        1986, section 1.3: the slow model.
        """
        fast = find_indices("linear.states", states, self.states)
        slow = [i for i in range(len(self.states)) if i not in set(np.asarray(fast).tolist())]
        own = self.A[np.ix_(fast, fast)]
        worst = np.linalg.eigvals(own).real.max(initial=-np.inf)
        if worst >= 0:
            names = ", ".join(self.states[i] for i in fast)
            problem = f"with all else held {names} has a pole of {worst:+.4g} 1/s: it does not settle"
            part = argument_name("fast")
            raise InputError(
                part, problem, fix=f"leave it out of {part}, or use a sensor or an estimator that gives it"
            )
        to, by = np.linalg.solve(own, self.A[np.ix_(fast, slow)]), np.linalg.solve(own, self.B[fast])
        inner, outer = self.A[np.ix_(slow, fast)], self.C[:, fast]
        A, B = self.A[np.ix_(slow, slow)] - inner @ to, self.B[slow] - inner @ by
        C, D = self.C[:, slow] - outer @ to, self.D - outer @ by
        names = tuple(self.states[i] for i in slow)
        return self._replace(A=A, B=B, C=C, D=D, x0=self.x0[slow], drift=self.drift[slow], states=names)

    def rescale(self, states: Any, inputs: Any = None, outputs: Any = None) -> "LinearModel":
        """The same in units of the given sizes of states (n,), inputs (m,) and outputs (p,); ones where not given."""
        sizes = []
        names = (self.states, self.inputs, self.outputs)
        for what, value, known in zip(("states", "inputs", "outputs"), (states, inputs, outputs), names, strict=True):
            s = np.ones(len(known)) if value is None else np.asarray(value, float)
            if s.shape != (len(known),) or not (np.isfinite(s) & (s > 0)).all():
                raise InputError(f"linear.scaled.{what}", f"{s}", fix=f"give {len(known)} finite sizes above 0")
            sizes.append(s)
        a, b, c = sizes
        A, B = self.A * a / a[:, None], self.B * b / a[:, None]
        C, D = self.C * a / c[:, None], self.D * b / c[:, None]
        return LinearModel(A, B, C, D, self.x0 / a, self.u0 / b, self.y0 / c, self.drift / a, *names)


def linearise(model: StateSpaceModel, x: Any = None, u: Any = None) -> LinearModel:
    """A, B, C, D at a point, by automatic differentiation.

    Where the point is no trim (`drift` not zero) the deviations obey dx' = A dx + B du + drift.

    Args:
        model: the system.
        x: state: vector, record, or changes to the model's own point.
        u: input, likewise.

    Source: [1] section 3.7, with derivatives instead of differences.
    """
    x0, u0 = model.point(x, u)
    A, B, C, D = model.slopes(x0, u0)
    drift, y0 = model.evaluate(x0, u0)
    for what, value, rows in (
        ("x'", np.column_stack([drift, A, B]), model.states),
        ("y", np.column_stack([y0, C, D]), model.outputs),
    ):
        bad = [n for n, row in zip(rows, value, strict=True) if not np.isfinite(row).all()]
        if bad:
            problem = f"{what} or its derivative is not finite for {', '.join(bad)}"
            keep, choose = argument_name("output"), argument_name("at")
            fix = f"keep the others alone with {keep}, or choose with {choose} a point where the model is smooth"
            raise InputError("linearise", problem, fix=fix)
    return LinearModel(A, B, C, D, x0, u0, y0, drift, model.states, model.inputs, model.outputs)


def _drop_rounding(value: float, size: float) -> float:
    return 0.0 if abs(value) <= ROUNDING * size else float(value)

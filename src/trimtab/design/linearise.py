"""Linearisation by automatic differentiation, in deviations from a point, with names for all states, inputs and
outputs.

This code runs offline and uses LAPACK.

Source: [1] B. L. Stevens, F. L. Lewis, E. N. Johnson, "Aircraft Control and Simulation", Wiley 2015, section 3.7.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError, argument_name
from trimtab.design.corners import find_corner
from trimtab.design.model import StateSpaceModel, find_indices
from trimtab.design.poles import balance_matrix, participation, sorted_poles

ROUNDING = 1e-10
"""Largest real or imaginary part of a pole that counts as zero, as a fraction of the largest entry of the scaled A."""
POLE_DISTANCE_MIN = 1e-6
"""Distance of two poles below which they are treated as one pole in the computation of participations, as a fraction of
the largest entry of the scaled A."""


class Eigenmode(NamedTuple):
    """Mode of a linear model: one real pole, or a conjugate pair.

    pole: the pole; for a pair, the pole with positive imaginary part.  frequency: |pole| (rad/s).  damping:
    -Re/|pole|; NaN at 0.  time_constant: 1/|Re pole| (s), of decay or growth; infinite for a pole on the imaginary
    axis.  states: name and participation of the states in the mode, largest first; the participations sum to 1 and do
    not depend on units.
    """

    pole: complex
    frequency: float
    damping: float
    time_constant: float
    states: tuple[tuple[str, float], ...]


class LinearModel(NamedTuple):
    """Linear model dx' = A dx + B du, dy = C dx + D du, in deviations from (x0, u0, y0).

    A: (n, n).  B: (n, m).  C: (p, n).  D: (p, m).  x0, u0, y0: the operating point.  drift: state derivative f(x0, u0)
    (n,), zero at a trim.  states, inputs, outputs: names.
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
        """Return the eigenvalues of A (n,), sorted by falling real part."""
        return sorted_poles(balance_matrix(self.A))

    def modes(self, *, least: float = 0.02) -> tuple[Eigenmode, ...]:
        """Return the modes, sorted by falling real part. States with a participation below `least` are omitted."""
        scaled = balance_matrix(self.A)
        size = max(np.abs(scaled).max(initial=0.0), np.finfo(float).tiny)
        modes: list[Eigenmode] = []
        for exact in sorted_poles(scaled):
            pole = complex(_drop_rounding(exact.real, size), _drop_rounding(exact.imag, size))
            if pole.imag < 0:
                continue
            share = participation(scaled, exact, POLE_DISTANCE_MIN * size)
            pairs = sorted(zip(self.states, share.tolist(), strict=True), key=lambda pair: -pair[1])
            states = tuple((n, s) for n, s in pairs if s >= least)
            frequency = abs(pole)
            damping = -pole.real / frequency if frequency else float("nan")
            slow = 1 / abs(pole.real) if pole.real else float("inf")
            modes.append(Eigenmode(pole, frequency, damping, slow, states))
        return tuple(modes)

    def table(self) -> str:
        """Return the modes as text, one mode per line."""
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
        """Return the model with only the named states, inputs and outputs, in the given order. The deviations of all
        other signals are taken as zero."""
        i = find_indices(argument_name("states"), self.states if states is None else states, self.states)
        j = find_indices(argument_name("inputs"), self.inputs if inputs is None else inputs, self.inputs)
        k = find_indices(argument_name("outputs"), self.outputs if outputs is None else outputs, self.outputs)
        pairs = ((self.states, i), (self.inputs, j), (self.outputs, k))
        labels = (tuple(names[q] for q in places) for names, places in pairs)
        A, B, C, D = self.A[np.ix_(i, i)], self.B[np.ix_(i, j)], self.C[np.ix_(k, i)], self.D[np.ix_(k, j)]
        return LinearModel(A, B, C, D, self.x0[i], self.u0[j], self.y0[k], self.drift[i], *labels)

    def settle(self, states: Iterable[str]) -> "LinearModel":
        """Return the slow model, in which the named fast states are replaced by their steady values.

        The steady values depend on the other states and the inputs. `x0` and `drift` refer to the remaining states.

        Raises: InputError if the named states are not stable while all others are held.

        Source: P. V. Kokotovic, H. K. Khalil, J. O'Reilly, "Singular perturbation methods in control", Academic Press
        1986, section 1.3: the slow model.
        """
        fast = find_indices("linear.states", states, self.states)
        slow = [i for i in range(len(self.states)) if i not in set(np.asarray(fast).tolist())]
        own = self.A[np.ix_(fast, fast)]
        worst = np.linalg.eigvals(own).real.max(initial=-np.inf)
        if worst >= 0:
            names = ", ".join(self.states[i] for i in fast)
            problem = f"with all other states held, {names} must be stable, but a pole is at {worst:+.4g} 1/s"
            part = argument_name("fast")
            raise InputError(
                part, problem, fix=f"remove the state from {part}, or provide the state by a sensor or estimator"
            )
        to, by = np.linalg.solve(own, self.A[np.ix_(fast, slow)]), np.linalg.solve(own, self.B[fast])
        inner, outer = self.A[np.ix_(slow, fast)], self.C[:, fast]
        A, B = self.A[np.ix_(slow, slow)] - inner @ to, self.B[slow] - inner @ by
        C, D = self.C[:, slow] - outer @ to, self.D - outer @ by
        names = tuple(self.states[i] for i in slow)
        return self._replace(A=A, B=B, C=C, D=D, x0=self.x0[slow], drift=self.drift[slow], states=names)

    def rescale(self, states: Any, inputs: Any = None, outputs: Any = None) -> "LinearModel":
        """Return the model in which each state, input and output is divided by its given size.

        states: (n,).  inputs: (m,).  outputs: (p,).  Default sizes: 1.
        """
        sizes = []
        names = (self.states, self.inputs, self.outputs)
        for what, value, known in zip(("states", "inputs", "outputs"), (states, inputs, outputs), names, strict=True):
            s = np.ones(len(known)) if value is None else np.asarray(value, float)
            if s.shape != (len(known),) or not (np.isfinite(s) & (s > 0)).all():
                problem = f"must be {len(known)} finite sizes above 0, got {s}"
                raise InputError(f"rescale.{what}", problem, fix="give one size for each name")
            sizes.append(s)
        a, b, c = sizes
        A, B = self.A * a / a[:, None], self.B * b / a[:, None]
        C, D = self.C * a / c[:, None], self.D * b / c[:, None]
        return LinearModel(A, B, C, D, self.x0 / a, self.u0 / b, self.y0 / c, self.drift / a, *names)


def linearise(model: StateSpaceModel, x: Any = None, u: Any = None) -> LinearModel:
    """Compute A, B, C, D at a point, by automatic differentiation.

    If the point is not a trim (`drift` not zero), the deviations follow dx' = A dx + B du + drift. A point at a corner
    or a jump of the model is rejected (`design.corners`).

    Args:
        model: the system.
        x: state, as a vector, a record, or changes to the model's own point.
        u: input, in the same forms.

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
            fix = f"choose a point where the model is smooth with {choose}, or keep only other outputs with {keep}"
            raise InputError("linearise", problem, fix=fix)
    corner = find_corner(model, x0, u0)
    if corner is not None:
        fix = f"choose another point nearby with {argument_name('at')}"
        if corner.row in model.outputs:
            fix += f", or keep only other outputs with {argument_name('output')}"
        raise InputError("linearise", f"{corner.row} has no slope at this point: {corner.reason}", fix=fix)
    return LinearModel(A, B, C, D, x0, u0, y0, drift, model.states, model.inputs, model.outputs)


def _drop_rounding(value: float, size: float) -> float:
    return 0.0 if abs(value) <= ROUNDING * size else float(value)

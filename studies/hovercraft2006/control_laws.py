"""Control laws: eigenvalues, limit points, and when spinning may begin.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections 2.2, 2.3.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from studies.hovercraft2006._flights import slow_manifold_slope
from studies.hovercraft2006._source import ARM, INERTIA, MASS, reference_row, reference_values
from trimtab.core.record import replace
from trimtab.core.signals import Estimate, PlanarState
from trimtab.laws.spin import (
    ConstantSpin,
    limit_point_value,
    safe_reference_bound,
    switching_energy,
    switching_energy_sharp,
)
from trimtab.laws.velocity import ForwardMomentum, ReverseMomentum, ZeroVelocity
from trimtab.study import Row, at_most, direction, same, within
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

jnp = jax.numpy
SECTION = "2.2"
CRAFT = Hovercraft()
PLACES = {
    "rest": "eq. 2.16, table 6.1",
    "forward": "eq. 2.24, table 6.2",
    "reverse": "eqs. 2.31 to 2.33, table 6.3",
    "spin": "eq. 2.39, table 6.4",
}


def published_laws() -> dict[str, Any]:
    """Return the four laws with the gains of [1] tables 6.1 to 6.4, for the package's vehicle."""
    return {
        "rest": ZeroVelocity(1.0, 2.5, CRAFT),
        "forward": ForwardMomentum(1.0, 4.0, 2.8, CRAFT),
        "reverse": ReverseMomentum(1.5, 1.0, 1.44, -1.98, CRAFT),
        "spin": ConstantSpin(0.5, 3.5, 3.0, CRAFT),
    }


def rows() -> Iterator[Row]:
    """Yield rows on settings, energy identities, eigenvalues, limit points, and the slow manifold."""
    yield from _settings()
    yield from _identities()
    for name, law in published_laws().items():
        at = HovercraftState(yaw_rate=3.0) if name == "spin" else law.equilibrium()
        yield from _eigenvalue_rows(name, law, at)
    yield from _limit_points()
    yield from _slow_manifold()


def _eigenvalue_rows(name: str, law: Any, at: HovercraftState) -> Iterator[Row]:
    values, roots = reference_values(f"eigenvalues/{name}-"), _eigenvalues(law, at)
    place = f"[1] {PLACES[name]}"
    for ident in (i for i in values if not i.endswith("-imaginary")):
        imaginary = f"{ident}-imaginary"
        root = roots[np.abs(roots - complex(values[ident], values.get(imaginary, 0.0))).argmin()]
        what = f"law {name}, eigenvalue {ident[-1]}"
        yield reference_row(ident, what, root.real, place, tolerance=1e-6, unit="1/s")
        if imaginary in values:
            what = f"{what}, imaginary part"
            yield reference_row(imaginary, what, root.imag, place, tolerance=1e-6, unit="1/s")


def _settings() -> Iterator[Row]:
    place, kg = "[1] section 4.1", 0.45359237
    misprint = "Misprint: the text's 5.7 lb, and the speeds quoted for the reference momenta, give 2.6 kg (errata)."
    given: dict[str, Any] = {"unit": "lb", "basis": "input"}
    yield within("mass/text", "mass of the simulated vehicle", 5.7, CRAFT.mass / kg, place, tolerance=0.05, **given)
    yield within(
        "mass/table-4.1",
        "mass",
        1.6,
        CRAFT.mass,
        "[1] table 4.1",
        tolerance=0.05,
        unit="kg",
        must_hold=False,
        note=misprint,
    )
    laws = published_laws()
    fig, what = "[1] section 6.1, fig. ", "at which the law settles"
    u, _, _ = _settle(laws["forward"])
    yield within("speed/forward", f"speed {what}, PXr = 2.8 kg m/s", 1.1, u, f"{fig}6.8", tolerance=0.05, unit="m/s")
    u, _, _ = _settle(laws["reverse"])
    what_r = f"speed {what}, PXr = -1.98 kg m/s"
    yield within("speed/reverse", what_r, -0.76, u, f"{fig}6.9", tolerance=0.005, unit="m/s")
    _, _, r = _settle(laws["spin"])
    spin = "angular momentum J r at 3 rad/s, where the law settles"
    momentum = CRAFT.inertia * r
    yield within("speed/spin", spin, 0.2880, momentum, "[1] table 6.4", tolerance=5e-5, unit="kg m²/s")
    least = _least_theta(laws["reverse"])
    what = "least θ with which the reverse law is stable"
    yield reference_row("theta/least", what, least, "[1] eqs. 2.30 and 2.33", tolerance=1e-6)
    broken = "The thesis's own gains violate its condition. The law is stable all the same (errata)."
    yield at_most(
        "forward/condition",
        "PXr/(k2 d) of the forward law's gains",
        "< 1",
        laws["forward"].reference / (laws["forward"].k2 * CRAFT.arm),
        "[1] eq. 2.24 with table 6.2",
        high=1.0,
        must_hold=False,
        note=broken,
    )


def _identities() -> Iterator[Row]:
    x = np.random.default_rng(0).uniform(-1, 1, (2000, 3)) * [2.0, 2.0, 8.0]
    u, v, r = x.T
    closed_forms = {
        "rest, V′": ("2.17", ZeroVelocity(0.7, 3.1, CRAFT), -0.7 * u**2 - 3.1 * (v - ARM * r) ** 2),
        "spin, W′": ("2.37", ConstantSpin(0.7, 3.1, -2.2, CRAFT), -0.7 * u**2 - 3.1 * (v - ARM * (r + 2.2)) ** 2),
    }
    for name, (equation, law, closed_form) in closed_forms.items():
        worst = np.abs(_lyapunov_rate(law)(x) - closed_form).max()
        what = f"law {name}: largest difference from its printed form, over 2000 states"
        place = f"[1] eq. {equation}"
        yield direction(f"decay/{equation}", what, f"eq. {equation}", worst, place, below=1e-9, unit="W")


def _limit_points() -> Iterator[Row]:
    W_bad, eps, sharp = (f(CRAFT, 3.0) for f in (limit_point_value, switching_energy, switching_energy_sharp))
    joule: dict[str, Any] = {"unit": "J", "tolerance": 1e-6}
    yield reference_row("spin/W-bad", "W at the bad limit point, 3 rad/s", W_bad, "[1] section 2.2.6", **joule)
    yield reference_row("spin/eps", "switching energy ε, 3 rad/s", eps, "[1] eq. 2.48", **joule)
    slower = switching_energy(CRAFT, 1.5)
    yield reference_row("spin/eps-slower", "switching energy ε, 1.5 rad/s", slower, "[1] eq. 2.48", **joule)
    note = "The thesis uses one bound for two roots. Separate bounds raise the limit by this factor."
    what = "sharp bound divided by ε"
    yield reference_row("spin/eps-sharp", what, sharp / eps, "[1] eq. 2.47", note=note, tolerance=1e-6)
    bounds = {"": (0.0, 1.0), "-swinging": (0.2, 2.0)}
    for end, (W, reference) in bounds.items():
        bound = safe_reference_bound(CRAFT, W, reference)
        what = f"least safe reference after {reference:g} rad/s with W = {W:g} J"
        yield reference_row(f"spin/provision{end}", what, bound, "[1] eq. 2.69", tolerance=1e-6, unit="rad/s")
    draws = np.random.default_rng(0)
    reference, W = draws.uniform(-6, 6, 100_000), draws.uniform(0, 3, 100_000)
    safe = (INERTIA + ARM**2 * MASS) * reference**2 / 2 > W
    wrong = int(((np.asarray(safe_reference_bound(CRAFT, W, reference)) < np.abs(reference)) != safe).sum())
    yield same(
        "spin/provision-safe",
        "cases of 100 000 in which v < |reference| and W < W_bad disagree",
        0,
        wrong,
        "[1] section 2.3, eq. 2.69",
        basis="text",
        note="A smaller safe reference is found exactly if the present one is safe.",
    )


def _slow_manifold() -> Iterator[Row]:
    note = "The rest law never holds a heading (errata)."
    what = "simulated slope of 1/(2 r²), 1000 to 2000 s"
    slope = slow_manifold_slope()
    yield reference_row("rest/slow-slope", what, slope, "[1] eq. 2.16", relative=1e-3, note=note, unit="s")


def _settle(law: Any) -> Any:
    """Return u, v, r (m/s, rad/s) of the closed loop after 100 s from a slow slide and turn."""
    rate, h = _closed_loop_rate(law), 0.01

    def advance(_: Any, x: Any) -> Any:
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        return x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))

    return np.asarray(jax.jit(lambda x: jax.lax.fori_loop(0, 10_000, advance, x))(jnp.array([0.0, -0.1, 0.1])))


def _least_theta(law: ReverseMomentum) -> float:
    """Return the least angle θ (rad) with which the linearised loop is stable, by bisection."""
    at = law.equilibrium()
    matrix = jax.jit(lambda theta: _linearise(replace(law, theta=theta), at))
    low, high = 0.1, 1.0
    for _ in range(40):
        middle = (low + high) / 2
        stable = np.linalg.eigvals(np.asarray(matrix(middle))).real.max() < 0
        low, high = (low, middle) if stable else (middle, high)
    return high


def _closed_loop_rate(law: Any) -> Any:
    def rate(x: Any) -> Any:
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=PlanarState(x[0], x[1], x[2], 0.0))
        demand = law.step(0, (), estimate)[1].demand
        d = CRAFT.dynamics(0.0, HovercraftState(x[0], x[1], x[2]), demand)
        return jnp.stack([d.surge_velocity, d.sway_velocity, d.yaw_rate])

    return rate


def _lyapunov_rate(law: Any) -> Any:
    """Return the rate of the law's Lyapunov function at states (n, 3), by automatic differentiation."""
    value = lambda x: law.lyapunov(PlanarState(x[0], x[1], x[2], 0.0))  # noqa: E731
    return jax.jit(jax.vmap(lambda x: jnp.dot(jax.grad(value)(x), _closed_loop_rate(law)(x))))


def _linearise(law: Any, at: HovercraftState) -> Any:
    return jax.jacfwd(_closed_loop_rate(law))(jnp.array([at.surge_velocity, at.sway_velocity, at.yaw_rate], float))


def _eigenvalues(law: Any, at: HovercraftState) -> Any:
    return np.linalg.eigvals(np.asarray(_linearise(law, at)))

"""Control laws: eigenvalues, limit points, and when spinning may begin.

[1] Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006, sections 2.2, 2.3.
"""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from studies.hovercraft2006._flights import slow_manifold_slope
from trimtab.core.signals import Estimate, PlanarState
from trimtab.laws.spin import (
    ConstantSpin,
    limit_point_value,
    safe_reference_bound,
    switching_energy,
    switching_energy_sharp,
)
from trimtab.laws.velocity import ForwardMomentum, ReverseMomentum, ZeroVelocity, slow_manifold_rate
from trimtab.study import Row, at_most, same, within
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

jnp = jax.numpy
SECTION = "2.2"
CRAFT = Hovercraft()
M, J, ARM = CRAFT.mass, CRAFT.inertia, CRAFT.arm

EIGENVALUES: tuple[tuple[str, Any, HovercraftState, str, tuple[complex, ...]], ...] = (
    ("rest", ZeroVelocity(1.0, 2.5), HovercraftState(), "eq. 2.16, table 6.1", (-3.6282, -0.3846, 0.0)),
    (
        "forward",
        ForwardMomentum(1.0, 4.0, 2.8),
        HovercraftState(surge_velocity=2.8 / M),
        "eq. 2.24, table 6.2",
        (-2.9026 + 2.4360j, -0.3846),
    ),
    (
        "reverse",
        ReverseMomentum(1.5, 1.0, 1.44, -1.98),
        HovercraftState(surge_velocity=-1.98 / M),
        "eqs. 2.31 to 2.33, table 6.3",
        (-0.5769, -0.5757 + 1.4856j),
    ),
    (
        "spin",
        ConstantSpin(0.5, 3.5, 3.0),
        HovercraftState(yaw_rate=3.0),
        "eq. 2.39, table 6.4",
        (-4.6751, -0.2984 + 2.6642j),
    ),
)
"""Law, where it rests, and its eigenvalues (1/s) there; of a pair the one above."""


def rows() -> Iterator[Row]:
    """Settings, energy identities, eigenvalues, limit points, and the slow manifold."""
    yield from _settings()
    yield from _identities()
    for law in EIGENVALUES:
        yield from _eigenvalue_rows(*law)
    yield from _limit_points()
    yield from _slow_manifold()


def _eigenvalue_rows(name: str, law: Any, at: HovercraftState, place: str, expected: Any) -> Iterator[Row]:
    found = _eigenvalues(law, at)
    about: dict[str, Any] = {"tolerance": 1e-3, "unit": "1/s", "basis": "reference"}
    for n, wanted in enumerate(expected, 1):
        got = found[np.abs(found - wanted).argmin()]
        what, ident = f"law {name}, eigenvalue {n}", f"eigenvalues/{name}-{n}"
        yield within(ident, what, float(np.real(wanted)), got.real, f"[1] {place}", **about)
        if np.imag(wanted):
            yield within(
                f"{ident}-imaginary",
                f"{what}, imaginary part",
                float(np.imag(wanted)),
                got.imag,
                f"[1] {place}",
                **about,
            )


def _settings() -> Iterator[Row]:
    mass = 5.7 * 0.45359237
    misprint = "Misprint: the text's 5.7 lb, and the speeds quoted for the reference momenta, give 2.6 kg (errata)."
    yield within("mass/text", "mass, 5.7 lb", 2.6, mass, "[1] section 4.1", tolerance=0.05, unit="kg")
    yield within(
        "mass/table-4.1", "mass", 1.6, M, "[1] table 4.1", tolerance=0.05, unit="kg", must_hold=False, note=misprint
    )
    rounded = {"tolerance": 0.05, "unit": "m/s"}
    yield within("speed/forward", "speed at PXr = 2.8 kg m/s", 1.1, 2.8 / M, "[1] section 6.1, fig. 6.8", **rounded)
    yield within(
        "speed/reverse",
        "speed at PXr = -1.98 kg m/s",
        -0.76,
        -1.98 / M,
        "[1] section 6.1, fig. 6.9",
        tolerance=0.005,
        unit="m/s",
    )
    yield within(
        "speed/spin", "yaw rate at Pir = 0.2880 kg m²/s", 3.0, 0.2880 / J, "[1] table 6.4", tolerance=1e-9, unit="rad/s"
    )
    theta = J / (ARM**2 * M)
    yield within(
        "theta/least",
        "least θ of the reverse law, J/(d² m)",
        0.3606,
        theta,
        "[1] eq. 2.33",
        tolerance=5e-5,
        basis="reference",
    )
    yield within("theta/setting", "θ = 4 J/(d² m)", 1.44, 4 * theta, "[1] table 6.3", tolerance=0.005)
    broken = "The source's own gains break its condition; the law is stable all the same (errata)."
    yield at_most(
        "forward/condition",
        "PXr/(k2 d) of the forward law's gains",
        "< 1",
        2.8 / (4.0 * ARM),
        "[1] eq. 2.24 with table 6.2",
        high=1.0,
        must_hold=False,
        note=broken,
    )


def _identities() -> Iterator[Row]:
    x = np.random.default_rng(0).uniform(-1, 1, (2000, 3)) * [2.0, 2.0, 8.0]
    u, v, r = x.T
    kappa = 1.9 / (3.1 * ARM)
    forward = v**2 - 2 * ARM * v * r + (1 + kappa) * ARM**2 * r**2
    wanted = {
        "rest, V′": ("2.17", ZeroVelocity(0.7, 3.1), -0.7 * u**2 - 3.1 * (v - ARM * r) ** 2),
        "forward, W′": ("2.23", ForwardMomentum(0.7, 3.1, 1.9), -0.7 * (u - 1.9 / M) ** 2 - 3.1 * forward),
        "spin, W′": ("2.37", ConstantSpin(0.7, 3.1, -2.2), -0.7 * u**2 - 3.1 * (v - ARM * (r + 2.2)) ** 2),
    }
    for name, (equation, law, closed_form) in wanted.items():
        worst = np.abs(_lyapunov_rate(law)(x) - closed_form).max()
        what = f"law {name}: closed form at 2000 states; largest difference"
        yield within(f"decay/{equation}", what, 0.0, worst, f"[1] eq. {equation}", tolerance=1e-9, unit="W")


def _limit_points() -> Iterator[Row]:
    derived = {"basis": "reference", "tolerance": 1e-4}
    W_bad, eps, sharp = (f(CRAFT, 3.0) for f in (limit_point_value, switching_energy, switching_energy_sharp))
    yield within(
        "spin/W-bad", "W at the bad limit point, 3 rad/s", 1.63008, W_bad, "[1] section 2.2.6", unit="J", **derived
    )
    yield within("spin/eps", "switching energy ε, 3 rad/s", 0.220142, eps, "[1] eq. 2.48", unit="J", **derived)
    slower = switching_energy(CRAFT, 1.5)
    yield within(
        "spin/eps-slower", "switching energy ε, 1.5 rad/s", 0.0550355, slower, "[1] eq. 2.48", unit="J", **derived
    )
    note = "The source bounds two roots by one; kept apart they allow this much more."
    yield within("spin/eps-sharp", "sharp bound over ε", 1.74321, sharp / eps, "[1] eq. 2.47", note=note, **derived)
    coefficient = safe_reference_bound(CRAFT, 0.0, 1.0)
    yield within(
        "spin/provision",
        "coefficient of the smaller reference",
        0.339846,
        coefficient,
        "[1] eq. 2.69",
        basis="reference",
        tolerance=1e-5,
    )
    draws = np.random.default_rng(0)
    reference, W = draws.uniform(-6, 6, 100_000), draws.uniform(0, 3, 100_000)
    safe = (J + ARM**2 * M) * reference**2 / 2 > W
    wrong = int(((np.asarray(safe_reference_bound(CRAFT, W, reference)) < np.abs(reference)) != safe).sum())
    yield same(
        "spin/provision-safe",
        "v < |reference| without W < W_bad, or the reverse, of 100 000",
        0,
        wrong,
        "[1] eq. 2.69",
        basis="reference",
    )


def _slow_manifold() -> Iterator[Row]:
    c = slow_manifold_rate(ZeroVelocity(1.0, 2.5))
    about: dict[str, Any] = {"unit": "s", "basis": "reference"}
    yield within(
        "rest/slow-rate", "c in r′ = -c r³ of the rest law", 1.9110, c, "[1] eq. 2.16", tolerance=1e-4, **about
    )
    note = "The rest law never holds a heading (errata)."
    yield within(
        "rest/slow-slope",
        "slope of 1/(2 r²) flown, 1000 to 2000 s",
        1.911,
        slow_manifold_slope(),
        "[1] eq. 2.16",
        relative=0.01,
        note=note,
        **about,
    )


def _closed_loop_rate(law: Any) -> Any:
    def rate(x: Any) -> Any:
        estimate = Estimate(t=0, age=0.0, fresh=True, valid=True, state=PlanarState(x[0], x[1], x[2], 0.0))
        demand = law.step(0, (), estimate)[1].demand
        d = CRAFT.dynamics(0.0, HovercraftState(x[0], x[1], x[2]), demand)
        return jnp.stack([d.surge_velocity, d.sway_velocity, d.yaw_rate])

    return rate


def _lyapunov_rate(law: Any) -> Any:
    """Rate of the law's Lyapunov function at states (n, 3), by automatic differentiation along the motion."""
    value = lambda x: law.lyapunov(PlanarState(x[0], x[1], x[2], 0.0))  # noqa: E731
    return jax.jit(jax.vmap(lambda x: jnp.dot(jax.grad(value)(x), _closed_loop_rate(law)(x))))


def _eigenvalues(law: Any, at: HovercraftState) -> Any:
    A = jax.jacfwd(_closed_loop_rate(law))(jnp.array([at.surge_velocity, at.sway_velocity, at.yaw_rate], float))
    return np.linalg.eigvals(np.asarray(A))

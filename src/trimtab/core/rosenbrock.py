"""A linearly implicit step for stiff systems: contact, stiff springs, fast valves. Each step inverts one matrix.

Source: [1] Hairer, Wanner, "Solving ordinary differential equations II", Springer 1996, section IV.7: RODAS, order four
with an embedded formula of order three. Both are stiffly accurate, so that an infinitely fast motion has decayed after
one step.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.integrate import Derivative
from trimtab.core.linalg import invert

GAMMA = 0.25
NODES = (0.0, 0.386, 0.21, 0.63, 1.0, 1.0)
A = (
    (),
    (1.544,),
    (0.9466785280815826, 0.2557011698983284),
    (3.314825187068521, 2.896124015972201, 0.9986419139977817),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
    (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
)
G = (
    (),
    (-5.6688,),
    (-2.430093356833875, -0.2063599157091915),
    (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
)
TIMES = (0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0)
"""Coefficients of the derivative with respect to time. Source: [1] program RODAS, default coefficients."""


def rodas(f: Derivative, t: Any, x: Any, h: Any) -> tuple[Any, Any]:
    """Return x after one step of x' = f(t, x) from t to t + h, and the difference from the embedded formula.

    x: any pytree of floats, with n numbers in total. The Jacobian (n, n) is computed by differentiating f.
    """
    leaves, tree = jax.tree.flatten(x)
    shapes = [np.shape(v) for v in leaves]

    def pack(values: Any) -> Any:
        return jnp.concatenate(
            [jnp.ravel(jnp.broadcast_to(jnp.asarray(v, np.float64), s)) for v, s in zip(values, shapes, strict=True)]
        )

    def unpack(y: Any) -> Any:
        ends = np.cumsum([0, *(int(np.prod(s)) for s in shapes)]).tolist()
        parts = [y[a:b].reshape(s) for a, b, s in zip(ends, ends[1:], shapes, strict=False)]
        return jax.tree.unflatten(tree, parts)

    def rate(time: Any, y: Any) -> Any:
        return pack(jax.tree.leaves(f(time, unpack(y))))

    y = pack(leaves)
    J = jax.jacfwd(rate, 1)(t, y)
    _, drift = jax.jvp(lambda time: rate(time, y), (t,), (jnp.ones_like(t),))
    inverse = invert(jnp.eye(len(y)) / (GAMMA * h) - J)
    us: list[Any] = []
    for c, a, g, d in zip(NODES, A, G, TIMES, strict=True):
        at = y + sum(w * u for w, u in zip(a, us, strict=True))
        right = rate(t + c * h, at) + sum(w * u for w, u in zip(g, us, strict=True)) / h + d * h * drift
        us.append(inverse @ right)
    y1 = y + sum(w * u for w, u in zip(A[-1], us, strict=False)) + us[-1]
    return unpack(y1), unpack(us[-1])

"""Systems of the literature whose zeros, degrees and singular points are known in closed form."""

import jax.numpy as jnp

from trimtab.core.signals import PlanarForce
from trimtab.design.model import model_of_functions, model_of_vehicle
from trimtab.vehicles.hovercraft import Hovercraft, HovercraftState

G = 9.81
BALL = 0.7143


def ball_and_beam(*, whole=True):
    """Hauser, Sastry, Kokotovic, IEEE Trans. AC 37 (1992), eq. 2.5: x = (r, r', theta, theta'), y = r, u = theta''.

    whole=False leaves out the centrifugal term, the first approximation of section 4.
    """

    def f(x, u):
        r, rd, th, w = x
        return jnp.stack([rd, BALL * ((r * w**2 if whole else 0.0) - G * jnp.sin(th)), w, u[0]])

    return model_of_functions(f, ("r", "rd", "theta", "w"), ("u",), h=lambda x, u: x[:1], outputs=("r",))


def vtol(eps, *, centre=False):
    """Hauser, Sastry, Meyer, Automatica 28 (1992), eq. 2.3, with gravity G; y = position of the centre of mass.

    centre=True: position of the centre of oscillation instead (Martin, Devasia, Paden, Automatica 32 (1996)).
    """

    def f(x, u):
        _, vx, _, vy, th, w = x
        s, c = jnp.sin(th), jnp.cos(th)
        return jnp.stack([vx, -u[0] * s + eps * u[1] * c, vy, u[0] * c + eps * u[1] * s - G, w, u[1]])

    def h(x, u):
        away = eps if centre else 0.0
        return jnp.stack([x[0] - away * jnp.sin(x[4]), x[2] + away * jnp.cos(x[4])])

    states = ("x", "vx", "y", "vy", "theta", "w")
    return model_of_functions(f, states, ("u1", "u2"), h=h, outputs=("x", "y"), u0=[G, 0.0])


def cart_pole(output, *, M=2.0, m=0.5, length=0.7):
    """Cart and upright pole (point mass), states (p, p', a, a'), force on the cart; output "p" or "a"."""

    def f(x, u):
        _, v, a, w = x
        s, c = jnp.sin(a), jnp.cos(a)
        push = (u[0] + m * length * w**2 * s - m * G * s * c) / (M + m * s**2)
        return jnp.stack([v, push, w, (G * s - push * c) / length])

    i = {"p": 0, "a": 2}[output]
    return model_of_functions(f, ("p", "v", "a", "w"), ("F",), h=lambda x, u: x[i : i + 1], outputs=(output,))


def hovercraft(away=0.0, **state):
    """The project's vehicle; y: the point `away` ahead of its centre of mass."""
    outputs = {
        "north": lambda x, u: x.north + away * jnp.cos(x.heading),
        "east": lambda x, u: x.east + away * jnp.sin(x.heading),
    }
    return model_of_vehicle(Hovercraft(), HovercraftState(**state), PlanarForce(0.0, 0.0), outputs=outputs)


def with_centripetal(model, name, rate, factor):
    """Feedback: `factor` times the square of a state is added to an input."""
    i, j = model.states.index(rate), model.inputs.index(name)
    return model._replace(f=lambda x, u: model.f(x, u.at[j].add(factor * x[i] ** 2)))

"""Functions of jax.scipy and jax.numpy.linalg."""

from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy as jsp
import jax.scipy.optimize
import numpy as np
from jax.scipy.special import betainc, digamma, erfinv, expi, gammainc, gammaln, i0e, i1, logsumexp, ndtri, zeta

from compiler.foreign.case import Case, normal, uniform


def _positive_definite(n: int, *shapes: tuple[int, ...]) -> Any:
    """A covariance of n variables, and other arrays."""

    def draw(rng: np.random.Generator) -> tuple[Any, ...]:
        a = rng.normal(size=(n, n))
        return a @ a.T + n * np.eye(n), *(rng.normal(size=s) for s in shapes)

    return draw


def _discretise(a: Any, b: Any) -> Any:
    """Matrices of a linear system over a sample of 0.1 s, by Van Loan."""
    n, m = b.shape
    whole = jnp.zeros((n + m, n + m)).at[:n, :n].set(a).at[:n, n:].set(b)
    exponential = jsp.linalg.expm(0.1 * whole)
    return exponential[:n, :n], exponential[:n, n:]


def _rosenbrock(x: Any) -> Any:
    return jnp.sum(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)


def _stable(rng: np.random.Generator) -> tuple[Any, ...]:
    a, q = rng.normal(size=(2, 4, 4))
    return a - 4 * np.eye(4), 4 * np.eye(4) + q, q @ q.T


CASES = [
    Case("matrix exponential (expm), 6 by 6", jsp.linalg.expm, normal((6, 6))),
    Case("discretisation by the matrix exponential", _discretise, normal((4, 4), (4, 2))),
    Case("linear equations, 6 by 6", jnp.linalg.solve, normal((6, 6), (6,))),
    Case(
        "linear equations with a symmetric matrix",
        lambda a, b: jsp.linalg.solve(a, b, assume_a="pos"),
        _positive_definite(6, (6, 2)),
    ),
    Case(
        "linear equations by Cholesky factors, 12 by 12",
        lambda a, b: jsp.linalg.cho_solve(jsp.linalg.cho_factor(a), b),
        _positive_definite(12, (12,)),
    ),
    Case("inverse of a 5 by 5 matrix", jnp.linalg.inv, normal((5, 5))),
    Case("gradient of the log determinant", jax.grad(lambda a: jnp.linalg.slogdet(a)[1]), _positive_definite(5)),
    Case(
        "least squares by QR",
        lambda a, b: jsp.linalg.solve_triangular(jnp.linalg.qr(a)[1], jnp.linalg.qr(a)[0].T @ b),
        normal((20, 4), (20,)),
    ),
    Case("least squares by lstsq", lambda a, b: jnp.linalg.lstsq(a, b)[0], normal((20, 4), (20,))),
    Case("pseudoinverse of a 3 by 7 matrix", jnp.linalg.pinv, normal((3, 7))),
    Case("singular values", lambda a: jnp.linalg.svd(a, compute_uv=False), normal((6, 4))),
    Case("eigenvalues of a symmetric matrix", jnp.linalg.eigvalsh, _positive_definite(6)),
    Case("eigenvalues of a general matrix", lambda a: jnp.abs(jnp.linalg.eigvals(a)), normal((4, 4)), refused="eig"),
    Case("Sylvester equation", lambda a, b, q: jsp.linalg.solve_sylvester(a, b, q), _stable, refused="complex128"),
    Case("matrix square root", lambda a: jnp.real(jsp.linalg.sqrtm(a)), _positive_definite(4), refused="complex128"),
    Case("polar decomposition", lambda a: jsp.linalg.polar(a)[0], normal((3, 3))),
    Case(
        "log density of a normal distribution, 4 dimensions",
        lambda x, m, c: jsp.stats.multivariate_normal.logpdf(x, m, c),
        lambda rng: (rng.normal(size=4), rng.normal(size=4), _positive_definite(4)(rng)[0]),
    ),
    Case(
        "log density of a mixture",
        lambda x, m: logsumexp(jsp.stats.norm.logpdf(x[:, None], m), axis=1),
        normal((50,), (3,)),
    ),
    Case("log gamma", gammaln, uniform(-5.5, 30, (40,))),
    Case("digamma", digamma, uniform(0.1, 30, (40,))),
    Case("regularized gamma function (chi-squared gate)", lambda x: gammainc(1.5, 0.5 * x), uniform(0, 20, (30,))),
    Case("regularized beta function (Student's t)", lambda x: betainc(2.5, 0.5, x), uniform(0, 1, (30,))),
    Case("quantile of the normal distribution", ndtri, uniform(0.001, 0.999, (30,))),
    Case("inverse error function", erfinv, uniform(-0.99, 0.99, (30,))),
    Case("Bessel I0, I1", lambda x: (i0e(x), i1(x)), uniform(-12, 12, (30,))),
    Case("exponential integral", expi, uniform(0.1, 10, (20,))),
    Case("Hurwitz zeta", lambda x: zeta(x, 1.5), uniform(1.5, 9, (20,))),
    Case(
        "BFGS of jax.scipy",
        lambda x: jsp.optimize.minimize(_rosenbrock, x, method="BFGS").x,
        lambda rng: (1 + 0.1 * rng.normal(size=3),),
    ),
    Case("conjugate gradients", lambda a, b: jsp.sparse.linalg.cg(lambda x: a @ x, b)[0], _positive_definite(8, (8,))),
    Case(
        "map_coordinates with linear interpolation",
        lambda x, p: jsp.ndimage.map_coordinates(x, p, order=1),
        lambda rng: (rng.normal(size=(9, 9)), rng.uniform(0, 8, size=(2, 15))),
    ),
    Case("convolution of signals", lambda x, h: jsp.signal.convolve(x, h, mode="same"), normal((100,), (9,))),
    Case("convolution by FFT", lambda x, h: jsp.signal.fftconvolve(x, h), normal((64,), (16,)), refused="fft"),
    Case("power spectrum", lambda x: jnp.abs(jnp.fft.rfft(x)) ** 2, normal((64,)), refused="fft"),
    Case("trapezoidal integral", jsp.integrate.trapezoid, normal((100,))),
]

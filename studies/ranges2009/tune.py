"""Tune the filter on each log separately: find the noise parameters that maximise the likelihood of its innovations.

    python -m studies.ranges2009.tune

Tuning uses the truth only for the initial pose. Parameters found on one log are used on the other.
"""

import json
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from studies.ranges2009._data import NAMES, plaza_log, read_plaza
from studies.ranges2009._filters import BEFORE, TUNED, odometry_filter
from trimtab.run.inputs import leaf_paths
from trimtab.run.replay import find_steps
from trimtab.run.replay_estimator import estimator_block

SCALE_BEFORE = 0.05
"""A-priori excess of the ranges, for delays in material other than air."""
EVALUATIONS = 40


def tune_log(name: str) -> dict[str, float]:
    """Return the parameters tuned on one log: those of BEFORE, and the final scale of the filter."""
    p, log = read_plaza(name), plaza_log(name)
    scale, found, cost = SCALE_BEFORE, dict(BEFORE), 0.0
    for _ in range(2):  # the second pass starts with the final scale of the first
        likelihood = _likelihood(p, log, scale)
        begin = np.log([found[k] for k in BEFORE])
        simplex = np.vstack([begin, begin + 0.5 * np.eye(len(begin))])
        options = {"maxfev": EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3}
        result = minimize(lambda v, of=likelihood: float(of(v)[0]), begin, method="Nelder-Mead", options=options)
        found, cost = dict(zip(BEFORE, np.exp(result.x).tolist(), strict=True)), float(result.fun)
        scale = float(likelihood(result.x)[1])
    return {k: float(f"{v:.4g}") for k, v in {**found, "scale": scale, "minus_log_likelihood": cost}.items()}


def _likelihood(p: Any, log: Any, scale: float) -> Any:
    """Return a function of log parameters: negative log likelihood of the ranges, up to a constant, and final scale."""
    block = estimator_block(log, odometry_filter(p, BEFORE, scale))
    leaves, tree = jax.tree.flatten(block.input)
    inputs = find_steps(log, leaf_paths(block.input), 1).inputs
    ends = np.cumsum([np.size(leaf) for leaf in leaves])
    columns = [
        inputs[:, end - np.size(leaf) : end].reshape(-1, *np.shape(leaf)).astype(np.asarray(leaf).dtype)
        for leaf, end in zip(leaves, ends, strict=True)
    ]
    frames = jax.tree.unflatten(tree, columns)

    @jax.jit
    def evaluate(v: Any) -> Any:
        estimator = odometry_filter(p, dict(zip(BEFORE, jnp.exp(v), strict=True)), scale)

        def body(s: Any, frame: Any) -> Any:
            after, estimate = block.step(estimator, s, frame)
            fix = estimate.state.position_fix
            came = fix.innovation != 0
            S = (fix.innovation / jnp.where(came, fix.normalised, 1.0)) ** 2
            nis = jnp.minimum(fix.nis, estimator.errors.gate)
            return after, (jnp.sum(jnp.where(came, nis + jnp.log(S), 0.0)), after.x[5])

        _, (costs, scales) = jax.lax.scan(body, block.init(estimator), frames)
        return jnp.sum(costs) / 2, scales[-1]

    return evaluate


def main() -> None:
    """Tune on each log, and write the parameters to tuned.json."""
    found = {}
    for name in NAMES:
        found[name] = tune_log(name)
        print(name, found[name])
    TUNED.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""What a ping does: to a filter that runs, to one that waits for a start, and how the one becomes the other.

Functions of a form (`TightlyCoupled`) and its node. Source: docs page, Tightly coupled ranging.
"""

from typing import Any

import jax
import numpy as np

from trimtab.core.float64 import jnp
from trimtab.core.record import replace
from trimtab.core.rotation import planar, wrap
from trimtab.estimators.inertial.coupled import told_from_rest
from trimtab.estimators.inertial.mechanisation import DIMENSION
from trimtab.estimators.inertial.sensor_watch import plus
from trimtab.estimators.ranging.position import ALL, ONE_REJECTED, RangingPosition
from trimtab.estimators.ranging.range_errors import counted_ranges, doubted
from trimtab.estimators.ranging.range_update import place_information, swept
from trimtab.estimators.ranging.start import found, located, nothing


def learns(form: Any, node: Any) -> Any:
    """Which states (9 + n,) a range corrects, 1.0, and which are considered, 0.0."""
    n = np.shape(form.beacons)[0]
    vehicle = jnp.ones(DIMENSION)
    if np.shape(form.units)[0] == 1:
        moves = told_from_rest(node.steady, node.P, form.noise, form.rest_smoothing, form.rest_sigmas)
        vehicle = jnp.where((np.arange(DIMENSION) % 5 == 0) & ~moves, 0.0, vehicle)
    own = jnp.where(node.position_fix.moved | (form.errors.survey_errors != "estimate"), 0.0, jnp.ones(n))
    return jnp.concatenate([vehicle, jnp.ones(1), own])


def agreeing(form: Any, node: Any, ranges: Any, unit: Any) -> tuple[Any, Any, Any]:
    """Which ranges (n,) agree with each other, the unit's place (2,), and whether three or more say so."""
    finder = RangingPosition(
        beacons=form.beacons,
        units=form.units,
        down=form.down,
        residual_limit=form.errors.residual,
        cone=form.cone,
    )
    fix, own = node.position_fix, node.x[DIMENSION + 1 :]
    usable = (ranges > 0) & ~(fix.moved & (fix.sigma_error > form.errors.residual))
    near = node.x[3:5] + planar(node.x[0]) @ form.geometry(unit).lever
    r = finder.locate((ranges - own) / (1 + node.x[DIMENSION]), usable, unit, near, fix.tracking)
    good = ((r.mode == ALL) | (r.mode == ONE_REJECTED)) & jnp.all(jnp.isfinite(r.place))
    few = jnp.sum(usable) <= 2
    agree = usable & (jnp.arange(ranges.shape[0]) != r.rejected) & (good | few)
    return agree, jnp.where(good, r.place, near), good


def tracked(form: Any, node: Any, ranges: Any, unit: Any, agree: Any) -> Any:
    """After a ping of a running filter."""
    heard = ranges > 0
    done = swept(node.x, node.P, ranges, heard & agree, form.geometry(unit), form.errors, learns(form, node))
    fix = counted_ranges(node.position_fix, heard, done, form.errors)
    moved, forgiven, lost = doubted(fix, form.errors)
    P = _redoubted(done.P, moved, forgiven, form.errors)
    fix = replace(
        fix,
        moved=(fix.moved | moved) & ~forgiven,
        agreed_in_a_row=jnp.where(moved | forgiven, 0, fix.agreed_in_a_row).astype(np.int32),
        refused_in_a_row=jnp.where(moved | lost, 0, fix.refused_in_a_row).astype(np.int32),
        mostly_refused=jnp.where(lost, 0, fix.mostly_refused).astype(np.int32),
        tracking=~lost,
    )
    P = jnp.where(lost, _joined(jnp.diag(form.start_variances()[:5]), P), P)
    start = either(lost, nothing(), node.start)
    return _noted(replace(node, x=done.x, P=P, start=start, position_fix=fix))


def started(form: Any, node: Any, unit: Any, agree: Any, place: Any, good: Any) -> Any:
    """After a ping of a filter that waits for a start."""
    g = form.geometry(unit)
    with_it = located(node.start, place, g.lever, place_information(place, agree, g, form.start_sigma))
    start = either(good, with_it, node.start)
    biases = jnp.sqrt(jnp.stack([node.P[5, 5], jnp.maximum(node.P[6, 6], node.P[7, 7])]))
    limits = {"longest": form.start_time, "heading_limit": form.start_heading}
    new = found(start, biases, enough=4, **limits)
    heading = node.x[0] + wrap(new.x[0] - node.x[0])
    x = jnp.concatenate([heading[None], new.x[1:], node.x[5:]])
    fix = node.position_fix
    used = (fix.used + jnp.sum(agree & good)).astype(np.int32)
    fix = replace(fix, used=used, tracking=new.believed, starts=plus(fix.starts, new.believed))
    return _noted(
        replace(
            node,
            x=jnp.where(new.believed, x, node.x),
            P=jnp.where(new.believed, _joined(new.P, node.P), node.P),
            start=either(new.believed | new.refuted, nothing(), start),
            position_fix=fix,
        )
    )


def _redoubted(P: Any, moved: Any, forgiven: Any, errors: Any) -> Any:
    """P with the errors of moved beacons (n,) grown, and those of forgiven ones as at first, known to nothing else."""
    none = jnp.zeros(DIMENSION + 1)
    wider = jnp.concatenate([none, jnp.where(moved, errors.moved**2, 0.0)])
    cut = jnp.concatenate([none, jnp.where(forgiven, 1.0, 0.0)]) > 0
    own = jnp.where(cut, errors.variances(moved.shape[0])[-1], wider)
    P = jnp.where(cut[:, None] | cut[None, :], 0.0, P)
    return P + jnp.where(np.eye(P.shape[0], dtype=bool), own[:, None], 0.0)


def _joined(own: Any, P: Any) -> Any:
    """P with a new covariance (5, 5) of heading, velocity and position that nothing else knows of."""
    across = jnp.zeros((5, P.shape[0] - 5))
    return jnp.concatenate([jnp.concatenate([own, across], axis=1), jnp.concatenate([across.T, P[5:, 5:]], axis=1)])


def _noted(node: Any) -> Any:
    """With what the fix tells of scale and beacons."""
    n = node.x.shape[0] - DIMENSION
    sigma = jnp.sqrt(jnp.maximum(jnp.stack([node.P[DIMENSION + i, DIMENSION + i] for i in range(n)]), 0.0))
    x = node.x[DIMENSION:]
    told = {"scale": x[0], "error": x[1:], "sigma_scale": sigma[0], "sigma_error": sigma[1:]}
    return replace(node, position_fix=replace(node.position_fix, **told))


def either(condition: Any, a: Any, b: Any) -> Any:
    """The tree a where a condition holds, else b."""
    return jax.tree.map(lambda x, y: jnp.where(condition, x, y), a, b)

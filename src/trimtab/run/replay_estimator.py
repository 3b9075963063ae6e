"""Replay of an estimator without the rest of an autopilot, with the samples in a log of any vehicle.

No scenario, vehicle or law is needed. The log must contain the samples that the estimator reads, with one row for each
instant at which a sample arrived. `logs.samples.log_samples` creates such a log.
"""

from typing import Any

import jax
import numpy as np

from trimtab.compiler.block import BlockDefinition
from trimtab.compiler.compiled_block import compile_block
from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.record import leaves, quantity, record, to_arrays
from trimtab.core.rng import key as root_key
from trimtab.core.signals import Frame, Sample
from trimtab.logs.log import Log
from trimtab.logs.samples import RECEIVED
from trimtab.loop.structure import cast_like, strengthen_types
from trimtab.run.inputs import leaf_paths
from trimtab.run.replay import find_steps, step_c, step_jax
from trimtab.run.runner import choose_c

ESTIMATE = "estimate"
"""First component of the log paths of the estimator's outputs."""


def replay_estimator(log: Log, estimator: Any, *, backend: str = "auto", seed: int = 0) -> Log:
    """Run an estimator with the samples in a log. Return a log with the estimator's outputs added as ``estimate.…``.

    Args:
        log: log whose signals ``downlink`` contain the samples of all sensors that the estimator reads. In the log of a
            simulation or flight, the rows at the control steps are used, as in `replay`.
        estimator: estimator, as used in an autopilot.
        backend: "c", "jax" or "auto", as in `simulate`.
        seed: seed of the estimator's random numbers, if the estimator uses random numbers.

    Raises:
        InputError: control steps, or signals that the estimator reads, are missing in the log.
    """
    if hasattr(estimator, "check"):
        estimator.check()
    block = estimator_block(log, estimator, seed)
    _check_fields(log, block)
    compiled = choose_c(backend, lambda: compile_block(block))
    period = int(log.metadata.get("parameters", {}).get("autopilot.period", 1))
    steps = find_steps(log, leaf_paths(block.input), period)
    outputs = step_jax(block, steps) if compiled is None else step_c(compiled, steps)
    kept = {p: v[steps.rows] for p, v in log.signals.items() if not p.startswith(f"{ESTIMATE}.")}
    estimate = jax.eval_shape(lambda: block.step(block.parameters, block.init(block.parameters), block.input)[1])
    after = {path: d for path, _, d in leaves(estimate) if isinstance(d, Quantity)}
    dtypes = [leaf.dtype for leaf in jax.tree.leaves(estimate)]
    new = {f"{ESTIMATE}.{p}": v.astype(d) for (p, v), d in zip(outputs.items(), dtypes, strict=True)}
    return Log(
        t=log.t[steps.rows],
        ticks=log.ticks[steps.rows],
        signals=kept | new,
        declarations={p: d for p, d in log.declarations.items() if p in kept}
        | {f"{ESTIMATE}.{path}": declared for path, declared in after.items()},
        metadata={**log.metadata, "backend": "jax" if compiled is None else "c"},
    )


def estimator_block(log: Log, estimator: Any, seed: int = 0) -> BlockDefinition:
    """Return an estimator as a block. Input: `Frame` with the samples in the log. Output: `Estimate`."""
    samples = {name: _sample_structure(log, name) for name in estimator.listens}
    parameters, key = to_arrays(estimator), root_key(seed)

    def step(p: Any, s: Any, now: Frame) -> Any:
        after, estimate = p.step(now.t, s, now)
        return cast_like(after, s), estimate

    def init(p: Any) -> Any:
        return strengthen_types(p.init(key))

    doc = f"{type(estimator).__name__}: one step for each row of a log."
    return BlockDefinition("estimator", doc, step, init, parameters, Frame(t=np.int64(0), samples=samples))


def _check_fields(log: Log, block: BlockDefinition) -> None:
    """Raise InputError if a field that the estimator reads is missing in the log's samples."""
    try:
        jax.eval_shape(lambda: block.step(block.parameters, block.init(block.parameters), block.input))
    except AttributeError as error:
        if type(error.obj).__name__ != "LoggedValue":
            raise
        names = [n for n, sample in block.input.samples.items() if isinstance(error.obj, type(sample.value))]
        sensor = next(iter(names), "a sensor")
        base = f"{RECEIVED}.{sensor}.value."
        there = [p.removeprefix(base) for p in log.paths if p.startswith(base)]
        problem = f"the log's samples of {sensor!r} have no field {error.name!r}, which the estimator reads"
        fix = f"add this field to the samples; for a log of another program, in the mapping [sensor.{sensor}.fields]:"
        fix += f"  {error.name} = {{from = …}}  or  {{constant = …}}"
        raise InputError("replay", problem, choices=there, fix=fix) from None


def _sample_structure(log: Log, name: str) -> Sample:
    base = f"{RECEIVED}.{name}.value."
    fields = {p.removeprefix(base): p for p in log.paths if p.startswith(base)}
    if not fields or f"{RECEIVED}.{name}.t" not in log:
        known = sorted({p.split(".")[1] for p in log.paths if p.startswith(f"{RECEIVED}.")})
        fix = "set the estimator to a sensor that the log contains, or write the samples with logs.samples.log_samples"
        problem = f"the log has no samples of {name!r}, which the estimator reads"
        raise InputError("replay", problem, choices=known, fix=fix)
    members = {field: log.declarations.get(path, Quantity("1", f"Field {field}.")) for field, path in fields.items()}
    body: dict[str, Any] = {n: quantity(d.unit, d.doc, frame=d.frame) for n, d in members.items()}
    cls = record(type("LoggedValue", (), {**body, "__annotations__": dict.fromkeys(body, Any)}))
    value: Any = cls(**{n: np.zeros(log[p].shape[1:], log[p].dtype) for n, p in fields.items()})
    no = np.bool_(False)
    return Sample(value=value, t=np.int64(0), age=np.float64(0), fresh=no, valid=no)

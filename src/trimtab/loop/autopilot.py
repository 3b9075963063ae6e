"""The Autopilot: estimator, law, allocation. It takes a Frame and gives a Command, and knows nothing of the world."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError, closest
from trimtab.core.record import children, is_record, part, period, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Command, Estimate, Frame, is_new
from trimtab.core.time import ms
from trimtab.links.fifo import NEVER, measurement_time
from trimtab.loop.structure import is_finite, zeros_of
from trimtab.loop.supervisor import Supervisor, SupervisorInput


@record
class AutopilotState:
    """Everything about the autopilot that changes, with its last outputs. Source: docs page, Time."""

    estimator: Any = part("State of the estimator.")
    law: Any = part("State of the law.")
    allocation: Any = part("State of the allocation.")
    estimate: Any = part("Last estimate.")
    output: Any = part("Last output of the law.")
    command: Any = part("Last command.")
    seen: Any = part("When each sample of the last frame had been measured, by the sensor's name.")
    supervisor: Any = part("State of the supervisor; nothing without one.", default=())
    supervised: Any = part("Last output of the supervisor.", default=())
    first: Any = part("First state of the law, from which each flight that a supervisor lets begin starts.", default=())


@record
class Autopilot:
    """Estimator, law and allocation at one control period.

    Until the estimate is valid the law stands still and the command is marked invalid, so that actuators stay neutral.
    So it does where what the law reads, or what it wants, is not finite: an estimate with a NaN in it is none.

    Source: docs page, Time.
    """

    estimator: Any = part("Frame in, estimate out.")
    law: Any = part("Estimate in, demand out.")
    allocation: Any = part("Demand in, actuator commands out.")
    period: int = period("Control period.", default=ms(1))
    supervisor: Supervisor | None = part("Whether it may fly; None: always.", default=None)

    def init(self, key: Key, frame: Frame) -> AutopilotState:
        """First state, for frames of this structure; refuses parts that don't fit each other."""
        self._check_listens(frame)
        states = [getattr(self, n).init(key.at(n)) for n in ("estimator", "law", "allocation")]
        _, estimate = zeros_of("autopilot.estimator", "world.sensors", self.estimator.step, 0, states[0], frame)
        self._check_reads(estimate)
        _, output = zeros_of("autopilot.law", "autopilot.estimator", self.law.step, 0, states[1], estimate)
        if not hasattr(output, "demand"):
            problem = f"the output of {type(self.law).__name__} has no field 'demand'"
            raise InputError("autopilot.law", problem, fix="return a record with demand=… from step()")
        allocate = self.allocation.step
        _, value = zeros_of("autopilot.allocation", "autopilot.law", allocate, 0, states[2], output.demand)
        command = Command(t=frame.t, valid=estimate.valid, value=value)
        state = AutopilotState(
            estimator=states[0],
            law=states[1],
            allocation=states[2],
            estimate=estimate,
            output=output,
            command=command,
            seen={name: np.int64(NEVER) for name in self._watched_samples(frame)},
        )
        if self.supervisor is None:
            return state
        self.supervisor.fit_neutral(estimate, value, frame)
        first, given = self.supervisor.init(), SupervisorInput(estimate, True, True)
        _, supervised = zeros_of("autopilot.supervisor", "", self.supervisor.step, 0, first, given)
        return replace(state, supervisor=first, supervised=supervised, first=states[1])

    def step(self, t: Any, state: AutopilotState, frame: Frame) -> tuple[AutopilotState, Command]:
        """The command at integer time t. What came since the last step is fresh, whenever that was."""
        seen = {name: measurement_time(frame.samples[name]) for name in state.seen}
        renewed = {n: replace(frame.samples[n], fresh=is_new(frame.samples[n], state.seen[n])) for n in seen}
        frame = replace(frame, samples={**frame.samples, **renewed})
        estimator, estimate = self.estimator.step(t, state.estimator, frame)
        read = [getattr(estimate.state, name) for name in self.law.reads]
        estimate = replace(estimate, valid=estimate.valid & is_finite(read))
        law, output = self.law.step(t, state.law, estimate)
        allocation, value = self.allocation.step(t, state.allocation, output.demand)
        finite = is_finite(value)
        sound = estimate.valid & finite
        new = AutopilotState(
            estimator=estimator,
            law=tree_where(sound, law, state.law),
            allocation=tree_where(finite, allocation, state.allocation),
            estimate=estimate,
            output=output,
            command=Command(t=t, valid=sound, value=value),
            seen=seen,
        )
        if self.supervisor is not None:
            new = self._supervise(self.supervisor, t, state, new, frame, finite)
        return new, new.command

    def _supervise(
        self, supervisor: Supervisor, t: Any, old: AutopilotState, new: AutopilotState, frame: Frame, finite: Any
    ) -> AutopilotState:
        """The same step, if the supervisor lets it be: else the command is neutral or not valid, and the law waits."""
        arrived = jnp.any(jnp.stack([jnp.asarray(frame.samples[name].fresh) for name in self.estimator.listens]))
        pilot = frame.samples.get(supervisor.pilot)
        state, said = supervisor.step(t, old.supervisor, SupervisorInput(new.estimate, arrived, finite, pilot))
        neutral = supervisor.fit_neutral(new.estimate, new.command.value, frame)
        value = tree_where(said.law, new.command.value, neutral)
        valid = jnp.where(said.law, new.command.valid, said.sends)
        waiting = tree_where(said.sends, old.law, old.first)
        return replace(
            new,
            law=tree_where(said.law, new.law, waiting),
            command=replace(new.command, value=value, valid=valid),
            supervisor=state,
            supervised=said,
            first=old.first,
        )

    def _watched_samples(self, frame: Frame) -> tuple[str, ...]:
        """Whose samples are told old from new: what the estimator reads, and the pilot's requests."""
        own = () if self.supervisor is None or self.supervisor.pilot not in frame.samples else (self.supervisor.pilot,)
        return (*self.estimator.listens, *(name for name in own if name not in self.estimator.listens))

    def drop_derived_outputs(self, state: AutopilotState, always: frozenset[int]) -> AutopilotState:
        """The state without outputs that are made anew at every instant, so that a run does not carry them along."""
        if self.period not in always:
            return state
        return replace(state, estimate=(), output=(), command=(), supervised=())

    def hold(self, t: Any, state: AutopilotState) -> AutopilotState:
        """The state between two control periods: last outputs kept, nothing fresh."""
        return replace(state, estimate=replace(state.estimate, t=t, fresh=False))

    def _check_reads(self, estimate: Estimate) -> None:
        provided = tuple(n for n, _, _ in children(estimate.state)) if is_record(estimate.state) else ()
        for name in self.law.reads:
            if name not in provided:
                near = closest(name, provided, 1)
                fix = f"read {near[0]!r} instead" if near else "use an estimator or a sensor that gives it"
                law, estimator = type(self.law).__name__, type(self.estimator).__name__
                problem = f"{law} reads {name!r}, which {estimator} does not give"
                raise InputError("autopilot.law", problem, choices=provided, fix=fix)

    def _check_listens(self, frame: Frame) -> None:
        for name in self.estimator.listens:
            if name not in frame.samples:
                sent = ", ".join(frame.samples) or "nothing"
                problem = f"the autopilot reads sensor {name!r}, the world sends ({sent})"
                fix = f'add sensors={{"{name}": …}} to the world, or name one that it sends'
                raise InputError("autopilot.estimator", problem, choices=frame.samples, fix=fix)

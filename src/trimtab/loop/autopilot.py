"""Autopilot: estimator, law and allocation.

Its input is a Frame (the newest sample of each sensor), its output a Command. The autopilot has no access to the true
state of the world.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import children, is_record, part, period, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import Command, Estimate, Frame, is_new
from trimtab.core.suggestions import closest
from trimtab.core.time import ms, to_seconds
from trimtab.links.fifo import NEVER, measurement_time
from trimtab.loop.monitor import Monitor, MonitorInput
from trimtab.loop.own_code import place_of
from trimtab.loop.predictor import Predictor
from trimtab.loop.setpoint_schedule import schedule_law
from trimtab.loop.structure import (
    check_output,
    check_state,
    first_state,
    is_finite,
    refuse_missing_numbers,
    step_part,
    zeros_of_step,
)
from trimtab.loop.supervisor import Supervisor, SupervisorInput


@record
class AutopilotState:
    """State of the autopilot: states and last outputs of its parts. Source: docs page, Time."""

    estimator: Any = part("State of the estimator.")
    law: Any = part("State of the law.")
    allocation: Any = part("State of the allocation.")
    estimate: Any = part("Last estimate.")
    output: Any = part("Last output of the law.")
    command: Any = part("Last command.")
    seen: Any = part("Measurement time of each sample of the last frame, by sensor name.")
    supervisor: Any = part("State of the supervisor, or empty without a supervisor.", default=())
    supervised: Any = part("Last output of the supervisor, or empty without a supervisor.", default=())
    first: Any = part(
        "Initial state of the law. The law restarts from this state at each flight that a supervisor starts.",
        default=(),
    )
    predictor: Any = part("State of the predictor, with its last prediction, or empty without a predictor.", default=())
    monitor: Any = part("State of the monitor, or empty without a monitor.", default=())

    def last_prediction(self) -> Any:
        """Return the last prediction, or () without a predictor."""
        return self.predictor.prediction if self.predictor else ()

    def last_verdicts(self) -> Any:
        """Return the monitor's last output for each formula, or () without a monitor."""
        return self.monitor.outputs if self.monitor else ()


@record
class Autopilot:
    """Autopilot: estimator, law and allocation, which run once per control period.

    >>> from trimtab import build
    >>> build("hovercraft/spin").autopilot.law.threshold
    'published'

    Until the estimate is valid, the law does not step and the command is marked invalid, so that the actuators stay
    neutral. The same happens while an input of the law or the command is not finite, because an estimate that contains
    NaN counts as invalid. The estimate that the law reads also contains the control period (s) as `dt` and, for a law
    that uses a pilot's stick, the newest stick sample. With a predictor, the law reads the state predicted for the time
    at which the law's command will act. The logged `estimate` is always the output of the estimator.

    Source: docs page, Time.
    """

    estimator: Any = part("Estimator, which computes an estimate from the received samples.")
    law: Any = part("Control law, which computes a demand from the estimate.")
    allocation: Any = part("Control allocation, which computes actuator commands from the demand.")
    period: int = period("Control period.", default=ms(1))
    supervisor: Supervisor | None = part(
        "Supervisor of the flight. None: the law's command is always sent.", default=None
    )
    schedules: Any = part("Schedules of the law's parameters that change during the flight.", default=())
    predictor: Predictor | None = part(
        "Predictor of the state at the time when the command will act. None: the law reads the estimate.", default=None
    )
    monitor: Monitor | None = part(
        "Monitor of temporal-logic formulas. None: no formulas are monitored.", default=None, optional=Monitor()
    )

    def init(self, key: Key, frame: Frame) -> AutopilotState:
        """Return the initial state. frame: example of a frame.

        Raise InputError if the autopilot's parts don't fit each other, e.g. if the law reads a field that the estimate
        lacks.
        """
        self._check_listens(frame)
        self._check_stick(frame)
        states = [
            first_state(f"autopilot.{n}", getattr(self, n).init, key.at(n)) for n in ("estimator", "law", "allocation")
        ]
        after, estimate = zeros_of_step(
            "autopilot.estimator", "world.sensors", self.estimator.step, 0, states[0], frame
        )
        check_state("autopilot.estimator", self.estimator.step, after, states[0])
        check_output("autopilot.estimator", self.estimator.step, estimate, Estimate)
        self._check_reads(estimate)
        read = self._complete(estimate, frame)
        after, output = zeros_of_step("autopilot.law", "autopilot.estimator", self.law.step, 0, states[1], read)
        check_state("autopilot.law", self.law.step, after, states[1])
        if not hasattr(output, "demand"):
            problem = f"{place_of(self.law.step)}the output of {type(self.law).__name__} has no field 'demand'"
            raise InputError("autopilot.law", problem, fix="return a record with demand=… from step()")
        refuse_missing_numbers("autopilot.law", self.law.step, output)
        allocate = self.allocation.step
        _, value = zeros_of_step("autopilot.allocation", "autopilot.law", allocate, 0, states[2], output.demand)
        command = Command(t=frame.t, valid=estimate.valid, value=value)
        state = AutopilotState(
            estimator=states[0],
            law=states[1],
            allocation=states[2],
            estimate=estimate,
            output=output,
            command=command,
            seen={name: np.int64(NEVER) for name in self._watched_samples(frame)},
            predictor=() if self.predictor is None else self.predictor.init(key.at("predictor"), estimate),
        )
        if self.supervisor is not None:
            self.supervisor.fit_neutral(estimate, value, frame)
            first, given = self.supervisor.init(), SupervisorInput(estimate, True, True)
            _, supervised = zeros_of_step("autopilot.supervisor", "", self.supervisor.step, 0, first, given)
            state = replace(state, supervisor=first, supervised=supervised, first=states[1])
        if self.monitor is not None:
            state = replace(state, monitor=self.monitor.init(_monitor_input(state, frame)))
        return state

    def step(self, t: Any, state: AutopilotState, frame: Frame) -> tuple[AutopilotState, Command]:
        """Return the autopilot's state and command at integer time t.

        Samples that arrived since the last step are marked as fresh.
        """
        received = frame
        seen = {name: measurement_time(frame.samples[name]) for name in state.seen}
        renewed = {n: replace(frame.samples[n], fresh=is_new(frame.samples[n], state.seen[n])) for n in seen}
        frame = replace(frame, samples={**frame.samples, **renewed})
        estimator, estimate = step_part(self.estimator, t, state.estimator, frame)
        estimate = replace(estimate, valid=estimate.valid & self._is_readable(estimate))
        predictor, ahead = state.predictor, estimate
        if self.predictor is not None:
            predictor, ahead = self.predictor.predict(t, state.predictor, estimate)
            ahead = replace(ahead, valid=ahead.valid & self._is_readable(ahead))
        scheduled = schedule_law(self.law, self.schedules, t)
        law, output = scheduled.step(t, state.law, self._complete(ahead, frame))
        allocation, value = self.allocation.step(t, state.allocation, output.demand)
        finite = is_finite(value)
        sound = ahead.valid & finite
        new = AutopilotState(
            estimator=estimator,
            law=tree_where(sound, law, state.law),
            allocation=tree_where(finite, allocation, state.allocation),
            estimate=estimate,
            output=output,
            command=Command(t=t, valid=sound, value=value),
            seen=seen,
            predictor=predictor,
        )
        if self.supervisor is not None:
            new = self._supervise(self.supervisor, t, state, new, frame, finite)
        if self.predictor is not None:
            new = replace(new, predictor=self.predictor.note(t, new.predictor, new.command))
        if self.monitor is not None:
            new = replace(new, monitor=self.monitor.step(t, state.monitor, _monitor_input(new, received)))
        return new, new.command

    def _supervise(
        self, supervisor: Supervisor, t: Any, old: AutopilotState, new: AutopilotState, frame: Frame, finite: Any
    ) -> AutopilotState:
        """Return the new state with the command that the supervisor permits.

        If the supervisor does not permit the law's command, the command is neutral or invalid, and the law does not
        step.
        """
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

    def _is_readable(self, estimate: Estimate) -> Any:
        """Return True if all values that the law reads are finite."""
        return is_finite([getattr(estimate.state, name) for name in self.law.reads])

    def _complete(self, estimate: Estimate, frame: Frame) -> Estimate:
        """Return the estimate with the control period, and with the pilot's stick if the law uses one.

        These two additions are not logged with the estimate.
        """
        estimate = replace(estimate, dt=to_seconds(self.period))
        name = optional_member(self.law, "stick")
        return replace(estimate, stick=frame.samples[name]) if name else estimate

    def _watched_samples(self, frame: Frame) -> tuple[str, ...]:
        """Return the names of the sensors whose samples are marked as new or old.

        These are the sensors of the estimator, and those of the pilot's stick and requests.
        """
        asked = (optional_member(self.law, "stick"), "" if self.supervisor is None else self.supervisor.pilot)
        own = dict.fromkeys(name for name in asked if name in frame.samples and name not in self.estimator.listens)
        return (*self.estimator.listens, *own)

    def drop_derived_outputs(self, state: AutopilotState, always: frozenset[int]) -> AutopilotState:
        """Return the state without outputs that are recomputed at every instant, so that a run does not store them."""
        if self.period not in always:
            return state
        return replace(state, estimate=(), output=(), command=(), supervised=())

    def hold(self, t: Any, state: AutopilotState) -> AutopilotState:
        """Return the state between two control steps: the last outputs, marked as not fresh."""
        return replace(state, estimate=replace(state.estimate, t=t, fresh=False))

    def _check_reads(self, estimate: Estimate) -> None:
        if isinstance(self.law.reads, str):
            problem = f"{place_of(type(self.law))}`reads` must be a tuple of field names, got a string"
            raise InputError("autopilot.law", problem, fix=f'reads = ("{self.law.reads}",)')
        provided = tuple(n for n, _, _ in children(estimate.state)) if is_record(estimate.state) else ()
        for name in self.law.reads:
            if name not in provided:
                near = closest(name, provided, 1)
                fix = f"read {near[0]!r} instead" if near else "use an estimator or a sensor that provides this value"
                law, estimator = type(self.law).__name__, type(self.estimator).__name__
                problem = f"{law} reads {name!r}, which the estimate of {estimator} does not contain"
                raise InputError("autopilot.law", problem, choices=provided, fix=fix)

    def _check_listens(self, frame: Frame) -> None:
        if isinstance(self.estimator.listens, str):
            problem = f"{place_of(type(self.estimator))}`listens` must be a tuple of sensor names, got a string"
            raise InputError("autopilot.estimator", problem, fix=f'listens = ("{self.estimator.listens}",)')
        for name in self.estimator.listens:
            if name not in frame.samples:
                sent = ", ".join(frame.samples) or "nothing"
                problem = f"the autopilot reads sensor {name!r}, but the world sends only ({sent})"
                fix = f'add sensors={{"{name}": …}} to the world, or use an estimator that reads a sensor of the world'
                raise InputError("autopilot.estimator", problem, choices=frame.samples, fix=fix)

    def _check_stick(self, frame: Frame) -> None:
        name = optional_member(self.law, "stick")
        if name and name not in frame.samples:
            sent = ", ".join(frame.samples) or "nothing"
            problem = f"{type(self.law).__name__} reads the pilot's stick {name!r}, but the world sends only ({sent})"
            fix = f'add sensors={{"{name}": StickScript(…)}} to the world, or set `stick` of the law to a sensor name'
            raise InputError("autopilot.law.stick", problem, choices=frame.samples, fix=fix)


def _monitor_input(state: AutopilotState, frame: Frame) -> MonitorInput:
    """Return the monitor's input: the outputs of this step and the frame, as they are logged."""
    return MonitorInput(state.estimate, state.output, state.command, frame.samples, state.supervised)

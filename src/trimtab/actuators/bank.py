"""Bank of actuators: a sequence of stages for each field of the vehicle's input."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.actuators.lag import NO_LIMIT
from trimtab.actuators.servo_pulse import ServoPulse, linear_pulse
from trimtab.core.errors import InputError
from trimtab.core.interfaces import optional_member
from trimtab.core.record import Scalar, declarations, is_record, part, period, quantity, record, replace, tree_where
from trimtab.core.rng import Key
from trimtab.core.signals import PlanarForce, Sample
from trimtab.core.time import ms, to_seconds


@record
class BankOutput:
    """Output of an actuator bank. Frames: those of the vehicle's input. Source: this module."""

    u: Any = part("Input of the vehicle.")
    limited: Scalar = quantity("1", "True if any actuator is at its rate limit or at a stop.", kind="flag")


@record
class ActuatorBank:
    """Bank of actuators: each field of the command passes through stages and becomes a field of the vehicle's input.

        ActuatorBank(Push(0.0), {"force": (TransportDelay(0.01), FirstOrderLag(0.05, rate_limit=200.0))})

    A field without stages follows its command without delay. Without a valid command the neutral input is commanded,
    and the actuators approach it with their own dynamics. The input of a stage is the output of the previous stage. The
    output of the last stage at the end of a period acts on the vehicle during that whole period.

    Frames:  those of the vehicle's input.    Source:  docs page, Actuators of any vehicle.
    """

    neutral_input: Any = part(
        "Neutral input of the vehicle, used without a valid command. It is a record of the same class as the command.",
        default=PlanarForce(0.0, 0.0),
    )
    stages: Any = part(
        "Stages of each field of the vehicle's input, in the order in which a command passes them.", default={}
    )
    period: int = period("Period of the actuators.", default=ms(1))

    def __post_init__(self) -> None:
        if isinstance(
            self.stages, Mapping
        ):  # a single stage need not be in a tuple; `stages` is not a mapping while JAX rebuilds the record
            rows = {name: (row if isinstance(row, tuple) else (row,)) for name, row in self.stages.items()}
            object.__setattr__(self, "stages", rows)

    def check(self) -> None:
        """Raise InputError for a field that the vehicle's input lacks, an invalid stage, or an unsuitable period."""
        kind = type(self.neutral_input)
        known = [*declarations(kind)] if is_record(self.neutral_input) else []
        for name, row in self.stages.items():
            if name not in known:
                problem = f"{kind.__name__} has no field {name!r}"
                raise InputError("stages", problem, choices=known, fix="name the stages after fields of the input")
            for stage in row:
                if not all(callable(getattr(stage, method, None)) for method in ("init", "step")):
                    problem = f"{type(stage).__name__} is not a stage: it lacks init(rest) or step(state, value, dt)"
                    raise InputError(
                        f"stages.{name}", problem, fix="write a stage as in trimtab.core.interfaces.ActuatorStage"
                    )
                optional_member(stage, "check_period")(self.period)

    def pulses(self) -> dict[str, ServoPulse]:
        """Return a table of pulse widths for each field of the input that has a ServoPulse stage or two stops."""
        tables = {}
        for name, row in self.stages.items():
            own = [stage for stage in row if isinstance(stage, ServoPulse)]
            lows = [float(stage.low) for stage in row if hasattr(stage, "low") and abs(stage.low) < NO_LIMIT]
            highs = [float(stage.high) for stage in row if hasattr(stage, "high") and abs(stage.high) < NO_LIMIT]
            if own or (lows and highs):
                tables[name] = own[0] if own else linear_pulse(max(lows), min(highs))
        return tables

    def neutral(self) -> BankOutput:
        """Return the neutral input."""
        return BankOutput(u=self.neutral_input, limited=np.bool_(False))

    def init(self, key: Key) -> dict[str, tuple[Any, ...]]:
        """Return the initial states of all stages, at the neutral input."""
        return {
            name: tuple(stage.init(getattr(self.neutral_input, name)) for stage in row)
            for name, row in self.stages.items()
        }

    def step(self, t: Any, state: dict[str, tuple[Any, ...]], command: Sample) -> tuple[Any, BankOutput]:
        """Return the new states, and the vehicle's input that acts from integer time t on."""
        wanted = tree_where(command.valid, command.value, self.neutral_input)
        dt, limited = to_seconds(self.period), jnp.zeros((), np.bool_)
        states, changes = {}, {}
        for name, row in self.stages.items():
            value, own = getattr(wanted, name), []
            for stage, before in zip(row, state[name], strict=True):
                after, out = stage.step(before, value, dt)
                value, limited = out.value, limited | out.limited
                own.append(jax.tree.map(jnp.asarray, after))
            states[name], changes[name] = tuple(own), value
        return states, BankOutput(u=replace(wanted, **changes), limited=limited)

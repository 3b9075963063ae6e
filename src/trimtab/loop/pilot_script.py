"""Scripted requests of a pilot to the supervisor, for simulations."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.record import period, quantity, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Motion, Sample
from trimtab.core.time import ms, to_seconds
from trimtab.loop.scenario import Scenario
from trimtab.loop.supervisor import NO_REQUEST, REQUESTS, PilotRequest


@record
class PilotScript:
    """Sensor that provides the pilot's requests to the supervisor, with one new sample for each scripted request.

    Before the first request, no sample is valid. In a flight over a real link, the ground station provides the samples.

    Frames:  none.    Source:  docs page, Supervisor.
    """

    times: Any = quantity(
        "100 ns", "Times of the pilot's requests, in rising order.", kind="time", default=np.zeros(0, np.int64)
    )
    requests: Any = quantity(
        "1",
        "Request of the pilot at each of the times.",
        kind="mode",
        modes=REQUESTS,
        default=np.zeros(0, np.int32),
        low=0,
        high=5,
    )
    period: int = period("Time between two samples of the pilot's requests.", default=ms(10))

    def check(self) -> None:
        """Raise InputError if the times don't rise by a period or more, or if times and requests differ in number."""
        times, requests = np.asarray(self.times), np.asarray(self.requests)
        if times.ndim != 1 or times.shape != requests.shape or (np.diff(times) < self.period).any():
            problem = (
                "there must be one time for each request, and times must rise by a period or more; "
                f"times: {len(times)}, requests: {len(requests)}"
            )
            fix = f"write one time per request, with at least {self.period} units of 100 ns between two times"
            raise InputError("times", problem, fix=fix)

    def init(self, key: Key) -> tuple[()]:
        """Return an empty state."""
        return ()

    def measure(self, motion: Motion) -> PilotRequest:
        """Return the request "none", because the pilot's requests don't depend on the motion."""
        return PilotRequest(request=np.int32(NO_REQUEST))

    def step(self, t: Any, state: tuple[()], motion: Motion) -> tuple[tuple[()], Sample]:
        """Return the state and the newest request at integer time t.

        The sample is marked as fresh once, at the first step after the request.
        """
        request, at, asked = jnp.asarray(np.int32(NO_REQUEST)), jnp.asarray(np.int64(0)), jnp.asarray(False)
        for k in range(np.shape(self.times)[0]):
            due = t >= self.times[k]
            request, at = jnp.where(due, self.requests[k], request), jnp.where(due, self.times[k], at)
            asked = asked | due
        fresh = asked & (t - at < self.period)
        value = PilotRequest(request=request.astype(np.int32))
        return state, Sample(value=value, t=at, age=to_seconds(t - at), fresh=fresh, valid=asked)


def pilot_script(*requests: tuple[int, str]) -> PilotScript:
    """Return a script of pilot's requests, each given as a pair (integer time, name of the request)."""
    for _, name in requests:
        if name not in REQUESTS[1:]:
            raise InputError(
                "pilot's script", f"unknown request {name!r}", choices=REQUESTS[1:], fix="use one of these names"
            )
    return PilotScript(
        times=np.array([t for t, _ in requests], np.int64),
        requests=np.array([REQUESTS.index(name) for _, name in requests], np.int32),
    )


def add_pilot_sensor(scenario: Scenario) -> Scenario:
    """Return the scenario with a sensor for the pilot's requests to the supervisor.

    A scenario without a supervisor, or with such a sensor, is returned unchanged.
    """
    supervisor, sensors = scenario.autopilot.supervisor, scenario.world.sensors
    if supervisor is None or supervisor.pilot in sensors:
        return scenario
    return replace(scenario, world=replace(scenario.world, sensors={**sensors, supervisor.pilot: PilotScript()}))

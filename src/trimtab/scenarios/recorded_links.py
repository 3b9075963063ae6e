"""Links of a scenario that repeat a recording, as `trimtab link-test --out` writes it, in place of its own.

Source: docs page, Latency trace.
"""

from collections.abc import Mapping

from trimtab.core.errors import InputError
from trimtab.core.record import replace
from trimtab.core.time import ms
from trimtab.links.fifo import slots_needed
from trimtab.links.latency_trace import LatencyTrace, read_trace
from trimtab.loop.scenario import Scenario

LINKS = ("uplink", "downlink")


def with_recordings(scenario: Scenario, settings: Mapping[str, str]) -> tuple[Scenario, dict[str, str]]:
    """The scenario over the recordings that ``uplink=FILE.csv`` and ``downlink=FILE.csv`` name; the other settings.

    Packets leave as often as those of the link whose place it takes, and the far end looks each millisecond.

    Raises: InputError for a file that is no recording.
    """
    world, rest = scenario.world, dict(settings)
    for name in LINKS:
        if name in rest:
            file, own = rest.pop(name), getattr(world, name)
            if not file.endswith(".csv"):
                fix = f"--set {name}=FILE.csv, as  trimtab link-test URI --out DIR  writes it"
                raise InputError(f"--set {name}", f"{file!r} is no recording", fix=fix)
            trace, each = read_trace(file), getattr(own, "send_period", own.period)
            slots = slots_needed(float(trace.latency_s.max()), each, ms(1))
            link = LatencyTrace.of(trace, send_period=each, period=ms(1), capacity=max(slots, 64))
            world = replace(world, **{name: link})
    return replace(scenario, world=world), rest

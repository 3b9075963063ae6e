"""Monitor inside a compiled autopilot. It reports violated formulas to the user and to the flight's log.

Source: docs pages, Fly and Monitor.
"""

from typing import NamedTuple

from trimtab.compiler.compiled_block import CompiledBlock
from trimtab.logs.robustness import VIOLATED, Assessment, format_robustness
from trimtab.loop.scenario import Scenario


class _Watched(NamedTuple):
    """Monitored formula. robustness, verdict: indices of the formula's robustness and verdict in the output vector of
    the compiled autopilot."""

    name: str
    text: str
    unit: str
    robustness: int
    verdict: int


class CompiledMonitor:
    """Reader of the monitor in a compiled autopilot. For an autopilot without a monitor, no formula is reported."""

    def __init__(self, scenario: Scenario, step: CompiledBlock) -> None:
        """step: compiled autopilot of the scenario."""
        monitor, self._step = scenario.autopilot.monitor, step
        self._watched: list[_Watched] = []
        if monitor is not None:
            inputs = {f"downlink{m.name.removeprefix('samples')}": m for m in step.text.inputs}
            known = {**inputs, **{m.name: m for m in step.text.outputs}}
            shapes = {path: m.shape for path, m in known.items()}
            units = {path: m.declaration.unit for path, m in known.items() if m.declaration is not None}
            for name, formula in monitor.fit_signals(shapes, units).items():
                places = (step.writes[f"monitor.{name}.{field}"] for field in ("robustness", "verdict"))
                self._watched.append(_Watched(name, formula.text, formula.unit, *places))
        self._broken: set[str] = set()

    def describe_changes(self) -> list[str]:
        """Return a message for each formula that became violated, or became satisfied again, since the last call."""
        lines, outputs = [], self._step.outputs
        for watched in self._watched:
            is_broken = int(outputs[watched.verdict]) == VIOLATED
            if is_broken == (watched.name in self._broken):
                continue
            self._broken ^= {watched.name}
            number = format_robustness(Assessment(watched.text, float(outputs[watched.robustness]), watched.unit))
            what = "VIOLATED" if is_broken else "holds again"
            lines.append(f"monitor: {watched.name} {what}, robustness {number}: {watched.text}")
        return lines

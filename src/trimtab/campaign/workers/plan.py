"""What decides every row of a campaign: plain data, so that a later session or another machine makes the same rows."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from trimtab.campaign.sampling.distributions import Amount, Distribution
from trimtab.core.time import ms
from trimtab.logs.provenance import provenance
from trimtab.loop.scenario import Scenario
from trimtab.run.program import described


class Plan(NamedTuple):
    """The campaign. Settings, imperfections and faults as `trimtab run` takes them.

    spread: what differs and what it is drawn from.  correlate: pairs of what was written, with their correlation.
    runs: of the whole campaign; only a Latin hypercube's rows depend on it.  success: conditions, all of which hold.
    """

    scenario: str
    settings: tuple[tuple[str, str], ...] = ()
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    seed: int = 0
    runs: int = 1000
    sampling: str = "random"
    spread: tuple[tuple[str, Distribution], ...] = ()
    correlate: tuple[tuple[str, str, float], ...] = ()
    metrics: tuple[str, ...] = ()
    success: tuple[str, ...] = ()
    log_period: int = ms(10)

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return json.loads(json.dumps(self._asdict() | {"spread": [[p, d._asdict()] for p, d in self.spread]}))


def plan_of(plain: Mapping[str, Any]) -> Plan:
    """The plan of what `Plan.plain` gave."""
    made: dict[str, Any] = {k: _tuples(v) for k, v in plain.items() if k != "spread"}
    spread = tuple((path, _distribution(d)) for path, d in plain["spread"])
    return Plan(**made, spread=spread)


def _distribution(plain: Mapping[str, Any]) -> Distribution:
    amounts = tuple(Amount(*a) for a in plain["amounts"])
    return Distribution(plain["text"], plain["kind"], amounts, tuple(plain["choices"]), tuple(plain["column"]))


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


def identity(plan: Plan, scenario: Scenario, backend: str) -> dict[str, str]:
    """What must be equal for two rows of one number to be equal: the campaign, the scenario, what computes it."""
    of_plan = plan.plain()
    if plan.sampling != "latin":
        del of_plan["runs"]
    about = described(scenario)
    of_scenario = {"parameters": about["parameters"], "parts": about["parts"]}
    made = {"campaign": _digest(of_plan), "scenario": _digest(of_scenario), "files": _digest(_files(plan))}
    return {**made, "backend": backend, **provenance()}


def _files(plan: Plan) -> dict[str, str]:
    """Name of each file of Python that the plan names -> digest of what it holds."""
    texts = (plan.scenario, *plan.metrics, *plan.success)
    names = {text.partition(".py:")[0].strip() + ".py" for text in texts if ".py:" in text}
    return {name: hashlib.sha256(Path(name).read_bytes()).hexdigest() for name in sorted(names)}


def _digest(plain: Any) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()[:16]

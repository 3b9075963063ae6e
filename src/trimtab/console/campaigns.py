"""Server side of the page of a campaign. The page shows each run as a point, and can repeat a run and compare it with
the nominal run.

The store of a campaign is untrusted data. The scenario that a store names is run only if trimtab's catalogue contains
this scenario.
Source: docs page, Protocol of the console.
"""

import asyncio
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.analysis.campaign.store.store import read_store
from trimtab.console.access import HEADERS
from trimtab.console.recordings import RecordingFeed, record_flight
from trimtab.core.errors import InputError
from trimtab.core.record import Quantity, leaves
from trimtab.run.simulate import simulate
from trimtab.scenarios.catalogue import load_scenario, scenario_names

OUTCOMES = ("success", "lost")
VERDICTS = ("failed", "succeeded")
MOST_FLIGHTS = 200
"""Maximum number of runs that one server repeats. After this number, the user must restart the server."""


class CampaignFeed:
    """Source of a campaign's data for the pages. It reads the campaign's store."""

    def __init__(self, folder: Path) -> None:
        """folder: folder of the campaign's store. Raises InputError if the scenario of the store is not in the
        catalogue."""
        attributes, self._columns = read_store(folder)
        plan = attributes["plan"]
        if plan["scenario"] not in scenario_names():
            problem = (
                f"the store belongs to the scenario {plan['scenario']!r}, which is not in the catalogue; files named "
                "by a store are never run"
            )
            raise InputError(
                f"store {str(folder)!r}", problem, fix="trimtab campaign FILE.py:FUNCTION --store … --rerun RUN"
            )
        self._command = str(attributes.get("command") or "trimtab campaign …")
        self.campaign = Campaign.from_dict(plan)
        self._nominal: int | None = None
        self._lock = asyncio.Lock()
        names = [name for name in self._columns if np.asarray(self._columns[name]).dtype.kind in "fiub"]
        self._names = ["run", *(name for name in names if name != "run")]
        hello = {"kind": "campaign", "title": self.campaign.plan.scenario, "columns": self._describe_columns()}
        empty = {"signals": [], "parameters": [], "supervisor": None, "pilot": None, "ages": [], "set_points": {}}
        self.feed = RecordingFeed(hello | empty | {"row_period": 0.02, "view": {"kind": "plain"}}, ())

    def routes(self) -> list[BaseRoute]:
        """Return the HTTP routes that serve the table of the campaign's runs, repeat a run, and serve the repeated
        runs."""
        return [
            Route("/campaign/rows", self._give_rows),
            Route("/campaign/fly", self._fly, methods=["POST"]),
            *self.feed.routes(),
        ]

    def _describe_columns(self) -> list[dict[str, Any]]:
        declared = {path: d for path, _, d in leaves(self.campaign.ready.scenario) if isinstance(d, Quantity)}
        metrics = {metric.name for metric in self.campaign.ready.metrics}
        found = []
        for name in self._names:
            role = "outcome" if name in OUTCOMES else "metric" if name in metrics else "drawn"
            known = declared.get(name)
            unit, meaning = ("", "") if known is None else (known.unit, known.doc)
            modes = list(VERDICTS) if name == "success" else None
            about = {"path": name, "unit": unit, "meaning": meaning, "modes": modes}
            found.append(about | {"role": "run" if name == "run" else role})
        return found

    async def _give_rows(self, request: Request) -> Response:
        table = np.stack([np.asarray(self._columns[name], np.float64) for name in self._names], axis=1)
        return Response(table.astype("<f8").tobytes(), headers=HEADERS)

    async def _fly(self, request: Request) -> Response:
        try:
            run = (await request.json())["run"]
        except (ValueError, KeyError, TypeError):
            run = None
        if not isinstance(run, int) or isinstance(run, bool) or run not in np.asarray(self._columns["run"]):
            return PlainTextResponse("the body of the request must contain the number of a run\n", 400, HEADERS)
        if len(self.feed.flights) >= MOST_FLIGHTS:
            return PlainTextResponse("too many runs were repeated: restart the console\n", 429, HEADERS)
        async with self._lock:
            return JSONResponse(await asyncio.to_thread(self._fly_again, run), headers=HEADERS)

    def _fly_again(self, run: int) -> dict[str, Any]:
        flights, plan = self.feed.flights, self.campaign.plan
        if self._nominal is None:
            scenario = load_scenario(plan.scenario)[0] if not plan.settings else self.campaign.ready.scenario
            log = simulate(scenario, seed=plan.seed, log_period=plan.log_period)
            flights.append(record_flight(log, "nominal", scenario=scenario))
            self._nominal = len(flights) - 1
        flights.append(record_flight(self.campaign.rerun(run), f"run {run}", scenario=self.campaign.scenario(run)))
        return {
            "flight": len(flights) - 1,
            "nominal": self._nominal,
            "command": f"{self._command} --rerun {shlex.quote(str(run))}",
            "outcome": self._outcome(run),
        }

    def _outcome(self, run: int) -> str:
        at = int(np.flatnonzero(np.asarray(self._columns["run"]) == run)[0])
        return "lost" if self._columns["lost"][at] else VERDICTS[int(self._columns["success"][at])]

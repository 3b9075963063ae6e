"""trimtab: guidance, navigation and control of vehicles that are hard to steer.

The front door: each name is imported when it is first used, so that ``import trimtab`` costs nothing.
"""

import importlib

__version__ = "0.1.0"

HOMES = {
    "record": "core.record",
    "quantity": "core.quantity",
    "part": "core.quantity",
    "option": "core.quantity",
    "period": "core.quantity",
    "replace": "core.record",
    "ms": "core.time",
    "seconds": "core.time",
    "InputError": "core.errors",
    "Target": "logs.metrics",
    "World": "loop.world",
    "Autopilot": "loop.autopilot",
    "Scenario": "loop.scenario",
    "build": "scenarios.build",
    "simulate": "run.simulate",
    "simulate_batch": "run.simulate",
    "Campaign": "campaign.campaign",
    "compile": "compiler.compiled_function",
    "export_c": "export.export_c",
    "open_link": "links.open_link",
}
"""Where each name of the front door lives."""


def __getattr__(name: str) -> object:
    if name not in HOMES:
        raise AttributeError(f"module 'trimtab' has no attribute {name!r}; it has {', '.join(HOMES)}")
    return getattr(importlib.import_module(f"trimtab.{HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *HOMES])

"""trimtab: guidance, navigation and control of vehicles that are hard to steer.

Each public name is imported from its module when the name is first used, so that ``import trimtab`` is fast.
"""

import importlib

__version__ = "0.1.0"

HOMES = {
    # to write your own vehicle, part or scenario
    "record": "core.record",
    "quantity": "core.quantity",
    "part": "core.quantity",
    "option": "core.quantity",
    "period": "core.quantity",
    "replace": "core.record",
    "ms": "core.time",
    "seconds": "core.time",
    "World": "loop.world",
    "Autopilot": "loop.autopilot",
    "Scenario": "loop.scenario",
    "Target": "logs.metrics",
    "InputError": "core.errors",
    # scenarios of the catalogue, and their settings
    "scenario_names": "scenarios.catalogue",
    "build": "scenarios.build",
    "settings": "scenarios.settings_table",
    "with_settings": "loop.settings",
    # simulation and logs
    "simulate": "run.simulate",
    "simulate_batch": "run.simulate",
    "plot_run": "plots.run",
    "metrics": "logs.metrics",
    "read_log": "logs.mcap:read_mcap",
    "write_log": "logs.mcap:write_mcap",
    "replay": "run.replay",
    # many runs
    "Campaign": "analysis.campaign.campaign",
    "error_budget": "run.error_budget",
    "falsify": "analysis.campaign.search.falsify",
    "tune": "analysis.campaign.search.tune",
    # design and code generation
    "trim": "vehicle_model",
    "linearise": "vehicle_model",
    "compile": "compiler.compiled_function",
    "export_c": "export.export_c",
}
"""Module of each public name; ``module:name`` if the object has another name in its module."""


__all__ = [*HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

OTHER_NAMES = {
    "fly": "simulate",
    "linearize": "linearise",
    "list": "scenario_names",
    "load": "read_log",
    "monte_carlo": "Campaign",
    "open": "read_log",
    "optimise": "tune",
    "optimize": "tune",
    "plot": "plot_run",
    "read": "read_log",
    "run": "simulate",
    "save": "write_log",
    "scenarios": "scenario_names",
    "sim": "simulate",
    "write": "write_log",
    "export": "export_c",
    "codegen": "export_c",
    "budget": "error_budget",
}
"""Synonym, or subcommand of the command line -> public name."""


def __getattr__(name: str) -> object:
    if name not in HOMES:
        if name.startswith("__"):
            raise AttributeError(f"module 'trimtab' has no attribute {name!r}")
        from trimtab.core.suggestions import closest  # imported here: only needed after a mistake

        near = OTHER_NAMES.get(name) or next(iter(closest(name, HOMES, 1)), "")
        write = f"; write  trimtab.{near}" if near else ""
        raise AttributeError(f"module 'trimtab' has no attribute {name!r}{write}; it has {', '.join(HOMES)}")
    module, _, own = HOMES[name].partition(":")
    return getattr(importlib.import_module(f"trimtab.{module}"), own or name)


def __dir__() -> list[str]:
    return sorted([*HOMES, "__doc__", "__file__", "__name__", "__path__", "__version__"])

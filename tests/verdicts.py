"""Verdicts of real-time tests: pass, fail, void and not judged. A plugin of pytest for tests marked real_time.

An attempt is void if the test failed and the host was later than the test bears (`host_witness`). A void attempt is
repeated twice at most. A test with three void attempts is not judged. This is never a pass: pytest's exit status is 1.
A repeat sets up all fixtures of the test again except those of the session.
"""

import time
from collections.abc import Generator
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from host_witness import Evidence, HostWitness

BEARS_MS = 20.0
"""Lateness of the host that a real-time test bears, where its mark does not say bears_ms."""
ATTEMPTS = 3
START_NS = pytest.StashKey[int]()


def judge(has_failed: bool, evidence: Evidence | None, bears_ms: float) -> str:
    """Return the verdict on one attempt: pass, fail or void."""
    if not has_failed:
        return "pass"
    return "void" if evidence and evidence.blame(bears_ms) else "fail"


def read_bears_ms(item: pytest.Item) -> float:
    """Return the lateness of the host in ms that a test bears, by its mark."""
    mark = item.get_closest_marker("real_time")
    return mark.kwargs.get("bears_ms", BEARS_MS) if mark else BEARS_MS


class Verdicts:
    """The hooks."""

    def __init__(self) -> None:
        self._witness: HostWitness | None = None
        self._set_up_ns: dict[Any, int] = {}

    def witness(self) -> HostWitness | None:
        """Return the witness, started at the first call, or None where the kernel gives no evidence."""
        if self._witness is None and HostWitness.is_possible():
            self._witness = HostWitness()
        return self._witness

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        self._set_up_ns[fixturedef] = time.monotonic_ns()
        return (yield)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> None:
        """Note when the oldest fixture of the test was set up that has a value: a test may judge what it measured."""
        own = [f for some in item._fixtureinfo.name2fixturedefs.values() for f in some]  # pyright: ignore[reportAttributeAccessIssue]
        valued = [f for f in own if f.scope != "session" and f.cached_result and f.cached_result[0] is not None]
        item.stash[START_NS] = min((self._set_up_ns[f] for f in valued if f in self._set_up_ns), default=2**63)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        if not item.get_closest_marker("real_time"):
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        reports: list[pytest.TestReport] = []
        for attempt in range(1, ATTEMPTS + 1):
            reports, reason = self._try(item, nextitem)
            if not reason:
                break
            for report in reports:
                if report.failed:
                    report.void = f"attempt {attempt}: {reason}"  # pyright: ignore[reportAttributeAccessIssue]
            if attempt == ATTEMPTS or item.session.shouldstop or item.session.shouldfail:
                break
            for report in reports:
                if report.failed:
                    report.outcome = "void"  # pyright: ignore[reportAttributeAccessIssue]
                    item.ihook.pytest_runtest_logreport(report=report)
            _prepare_repeat(item)
        for report in reports:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _try(self, item: pytest.Item, nextitem: pytest.Item | None) -> tuple[list[pytest.TestReport], str]:
        """Run the test once. Return its reports, and why the attempt is void, if it is."""
        witness, start = self.witness(), time.monotonic_ns()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if witness is None or not any(report.failed for report in reports):
            return reports, ""
        evidence = witness.collect(min(start, item.stash.get(START_NS, start)), time.monotonic_ns())
        bears_ms = read_bears_ms(item)
        return reports, evidence.blame(bears_ms) if judge(True, evidence, bears_ms) == "void" else ""

    def pytest_report_teststatus(self, report: Any) -> tuple[str, str, tuple[str, dict[str, bool]]] | None:
        if report.outcome == "void":
            return "void", "V", ("VOID", {"yellow": True})
        if hasattr(report, "void"):
            return "not judged", "N", ("NOT JUDGED", {"red": True})
        return None

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        for kind in ("void", "not judged"):
            reports = terminalreporter.stats.get(kind, [])
            if reports:
                terminalreporter.section(f"{kind}: the host was late")
            for report in reports:
                terminalreporter.line(f"{report.nodeid}, {report.void}")
                terminalreporter.line(report.longreprtext)
                for name, text in report.sections:
                    terminalreporter.section(name, "-")
                    terminalreporter.line(text)

    def pytest_unconfigure(self) -> None:
        if self._witness is not None:
            self._witness.close()


def _prepare_repeat(item: pytest.Item) -> None:
    """Tear down all fixtures below the session, drop captured output, and start the timeout again."""
    item._report_sections.clear()
    try:
        item.session._setupstate.teardown_exact(item.session)  # pyright: ignore[reportArgumentType]
    except Exception as problem:
        item.add_report_section("teardown", "void attempt", repr(problem))
    if hasattr(item.ihook, "pytest_timeout_set_timer"):
        from pytest_timeout import _get_item_settings

        wanted = _get_item_settings(item)
        item.ihook.pytest_timeout_cancel_timer(item=item)
        if wanted.timeout and not wanted.func_only:
            item.ihook.pytest_timeout_set_timer(item=item, settings=wanted)

"""Supervisor: every sequence of five inputs against a reference state machine, its documentation, and flights."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trimtab.actuators.drive import NEUTRAL_COMMAND
from trimtab.compiler.compiled_function import compile
from trimtab.compiler.native.compiler import find_compiler
from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, quantity, record, replace, to_arrays
from trimtab.core.signals import Estimate, PlanarForce, Sample
from trimtab.core.time import ms, seconds
from trimtab.loop.pilot_script import PilotScript, pilot_script
from trimtab.loop.structure import strengthen_types
from trimtab.loop.supervisor import CAUSES, CHECKS, MODES, REQUESTS, Limit, PilotRequest, Supervisor, SupervisorInput
from trimtab.run.blocks import compile_autopilot
from trimtab.run.simulate import simulate
from trimtab.scenarios import catalogue


@record
class Belief:
    """Source: this test."""

    north: Scalar = quantity("m", "North.")
    east: Scalar = quantity("m", "East.")
    surge_velocity: Scalar = quantity("m/s", "Surge.")
    frozen: Scalar = quantity("1", "Sensor.", kind="flag")


STEP = ms(250)
LIMITS = (
    Limit(fields=("north", "east"), high=5.0),
    Limit(fields=("surge_velocity",), low=-1.0, high=2.0, kind="envelope"),
)
SUPERVISOR = Supervisor(
    neutral=NEUTRAL_COMMAND,
    limits=LIMITS,
    healthy=("frozen",),
    link_timeout=ms(200),
    link_continue=ms(250),
    link_end=ms(500),
    stale_continue=ms(500),
    stale_end=ms(750),
)
EVENTS = ("", *REQUESTS[1:], "silent", "stale", "invalid", "outside", "fast", "sick", "not finite", "nan")
"""What happens at one step; "nan": a position that is no number."""


@pytest.mark.parametrize(
    ("place", "speed", "breached"),
    [
        ((3.0, 4.0), 0.0, (False, False)),
        ((3.0, 4.001), 0.0, (True, False)),
        ((-3.0, -4.001), 2.0, (True, False)),
        ((0.0, 0.0), 2.001, (False, True)),
        ((0.0, 0.0), -1.0, (False, False)),
        ((0.0, 0.0), -1.001, (False, True)),
        ((np.nan, 0.0), np.nan, (True, True)),
    ],
)
def test_limit_is_breached_on_both_sides_and_by_nan(place, speed, breached):
    belief = Belief(*place, speed, np.bool_(False))
    assert tuple(bool(limit.is_breached(belief)) for limit in LIMITS) == breached


def given(event, request=None):
    """Return the input of an event; any event may come with a request."""
    place = {"outside": (3.1, 4.0), "nan": (np.nan, 0.0)}.get(event, (3.0, 3.9))
    belief = Belief(*map(np.float64, place), np.float64(2.5 if event == "fast" else 1.0), np.bool_(event == "sick"))
    estimate = Estimate(
        t=np.int64(0),
        age=np.float64(0.5 if event == "stale" else 0.05),
        fresh=np.bool_(True),
        valid=np.bool_(event != "invalid"),
        state=belief,
    )
    asked = REQUESTS.index(request or (event if event in REQUESTS else "none"))
    pilot = Sample(PilotRequest(np.int32(asked)), np.int64(0), np.float64(0.0), np.bool_(asked > 0), np.bool_(True))
    return SupervisorInput(estimate, np.bool_(event != "silent"), np.bool_(event != "not finite"), pilot)


TABLE = jax.tree.map(lambda *v: np.stack(v), *(given(e) for e in EVENTS))
block = to_arrays(SUPERVISOR)
step = jax.jit(SUPERVISOR.step)


def _scan(block, sequence):
    def body(s, k_event):
        k, event = k_event
        return block.step(k * STEP, s, jax.tree.map(lambda v: jnp.asarray(v)[event], TABLE))

    return jax.lax.scan(
        body, strengthen_types(block.init()), (jnp.arange(sequence.shape[0], dtype=np.int64), sequence)
    )[1]


many = jax.jit(jax.vmap(_scan, (None, 0)))


class Plain:
    """State machine written from the table on the documentation page."""

    def __init__(self):
        self.mode, self.cause, self.since, self.back, self.heard = "standby", "start", None, "standby", None

    def step(self, t, event):
        """Mode, cause, (sends, law)."""
        if event != "silent":
            self.heard = t
        silent = self.heard is None or t - self.heard >= 200
        stale, valid = event == "stale", event != "invalid"
        ready = not silent and event not in ("stale", "invalid", "outside", "nan", "fast", "sick")
        new = self._next(t, event, silent, stale, valid, ready)
        if new is not None:
            mode, self.cause = new
            if mode == "lost":
                self.back = self.mode
            self.mode, self.since = mode, t
        elif self.mode == "lost" and event == "hold":
            self.back = "hold"
        goes_on = 250 if self.cause == "link lost" else 500
        carried = self.mode == "lost" and self.back == "flying" and t - self.since < goes_on and valid
        law = self.mode == "flying" or carried
        return self.mode, self.cause, self.mode in ("flying", "hold", "lost"), law

    def _next(self, t, event, silent, stale, valid, ready):
        mode = self.mode
        if mode == "standby":
            return ("flying", "arm request") if event == "arm" and ready else None
        if mode in ("fault", "ended"):
            return ("standby", "clear request") if event == "clear" else None
        if mode == "flying" and event == "not finite":
            return "fault", "command not finite"
        if event in ("outside", "nan"):
            return "fault", "geofence"
        if event == "fast":
            return "fault", "speed envelope"
        if mode == "flying" and not valid:
            return "fault", "estimate not valid"
        if mode == "flying" and event == "sick":
            return "fault", "sensor health"
        if event == "end":
            return "ended", "end request"
        if mode == "lost":
            if not silent and not stale:
                return ("hold" if event == "hold" else self.back), "found again"
            end = 500 if self.cause == "link lost" else 750
            return ("ended", "lost for too long") if t - self.since >= end else None
        if silent:
            return "lost", "link lost"
        if stale:
            return "lost", "estimate stale"
        if mode == "flying":
            return ("hold", "hold request") if event == "hold" else None
        return ("flying", "resume request") if event == "resume" and ready else None


def _told(out, i):
    return [
        (MODES[m], CAUSES[c], bool(s), bool(w))
        for m, c, s, w in zip(out.mode[i], out.cause[i], out.sends[i], out.law[i], strict=True)
    ]


@pytest.fixture(scope="module")
def sequences():
    """Arming, then every sequence of four events and one more step, with the outputs."""
    tails = np.array(list(itertools.product(range(len(EVENTS)), repeat=4)))
    heads = np.full((len(tails), 1), EVENTS.index("arm"))
    all_of_them = np.concatenate([np.concatenate([heads, tails], 1), np.concatenate([tails, heads], 1)])
    return all_of_them, jax.tree.map(np.asarray, many(block, all_of_them))


@pytest.mark.thorough
def test_every_event_sequence_matches_the_reference_state_machine(sequences):
    events, out = sequences
    seen = set()
    for i, sequence in enumerate(events):
        plain = Plain()
        rows = [plain.step(250 * k, EVENTS[e]) for k, e in enumerate(sequence)]
        assert _told(out, i) == rows, [EVENTS[e] for e in sequence]
        seen |= {(a[0], *b[:2]) for a, b in itertools.pairwise(rows)}
    assert {cause for _, _, cause in seen} == set(CAUSES) - {"automatic"}, "all but one cause have been seen"


@pytest.mark.thorough
def test_invariants_hold_in_every_event_sequence(sequences):
    _, out = sequences
    mode = out.mode
    stopped = np.isin(mode, [MODES.index("fault"), MODES.index("ended"), MODES.index("standby")])
    assert not out.sends[stopped].any()
    assert not out.law[stopped].any()
    assert out.sends[~stopped].all()
    latched = np.isin(mode[:, :-1], [MODES.index("fault"), MODES.index("ended")])
    after = mode[:, 1:][latched]
    assert set(np.unique(after)) == {MODES.index(m) for m in ("standby", "fault", "ended")}
    changes = (np.diff(mode, axis=1) != 0).sum(axis=1) + (mode[:, 0] != 0)
    np.testing.assert_array_equal(out.transitions[:, -1], changes)


def run(*events, block=block):
    told = [EVENTS.index(e) for e in events]
    return jax.tree.map(lambda v: np.asarray(v)[0], many(block, np.array([told])))


@pytest.mark.parametrize(
    ("event", "check"),
    [
        ("invalid", "estimate not valid"),
        ("stale", "estimate stale"),
        ("outside", "outside limits"),
        ("nan", "outside limits"),
        ("fast", "outside limits"),
        ("sick", "sensor health"),
    ],
)
def test_failed_check_prevents_arming(event, check):
    s, out = step(np.int64(0), strengthen_types(block.init()), given(event, "arm"))
    assert (MODES[int(out.mode)], CHECKS[int(out.refused)], int(out.refusals)) == ("standby", check, 1)
    assert CHECKS[int(out.check)] == check
    _, out = step(np.int64(ms(1)), s, given("arm"))
    assert MODES[int(out.mode)] == "flying"


def test_silent_link_prevents_arming():
    out = run("silent", "arm")
    assert [MODES[m] for m in out.mode] == ["standby", "flying"]
    _, out = step(np.int64(0), strengthen_types(block.init()), given("silent", "arm"))
    assert CHECKS[int(out.refused)] == "link silent"


@pytest.mark.parametrize(("before", "request_"), [("arm", "arm"), ("", "resume"), ("arm", "resume")])
def test_rejects_requests_invalid_in_the_current_mode(before, request_):
    out = run(before, request_)
    assert int(out.refusals[-1]) == 1
    assert CHECKS[int(out.refused[-1])] == "mode"


def test_stale_or_unknown_request_is_ignored():
    again = replace(given("arm"), pilot=replace(given("arm").pilot, fresh=np.bool_(False)))
    _, out = step(np.int64(0), strengthen_types(block.init()), again)
    assert MODES[int(out.mode)] == "standby"
    wild = replace(given("arm"), pilot=replace(given("arm").pilot, value=PilotRequest(np.int32(77))))
    _, out = step(np.int64(0), strengthen_types(block.init()), wild)
    assert MODES[int(out.mode)] == "standby"


def test_automatic_arms_once_checks_pass_but_clears_no_fault():
    out = run("invalid", "stale", "", "outside", "", block=to_arrays(replace(SUPERVISOR, automatic=True)))
    assert [MODES[m] for m in out.mode] == ["standby", "standby", "flying", "fault", "fault"]
    assert CAUSES[out.cause[2]] == "automatic"


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_c_supervisor_matches_jax(sequences):
    events, out = sequences
    compiled = compile(_scan, block, events[0])
    for i in np.random.default_rng(1).integers(0, len(events), 300):
        for a, b in zip(jax.tree.leaves(compiled(block, events[i])), jax.tree.leaves(out), strict=True):
            np.testing.assert_array_equal(a, b[i])


def test_rejects_invalid_limits_and_pilot_scripts():
    with pytest.raises(InputError, match=r"link_end.*must be later"):
        replace(SUPERVISOR, link_end=ms(100)).check()
    with pytest.raises(InputError, match="must be below"):
        Limit(fields=("north",), low=2.0, high=1.0).check()
    with pytest.raises(InputError, match="at least one field"):
        Limit(fields=()).check()
    with pytest.raises(InputError, match="unknown request 'fly'"):
        pilot_script((0, "fly"))
    with pytest.raises(InputError, match="rise by a period or more"):
        pilot_script((ms(20), "arm"), (ms(25), "hold")).check()
    pilot_script((ms(20), "arm"), (ms(30), "hold")).check()


@pytest.fixture(scope="module")
def flight():
    scenario, _ = catalogue.load_scenario("hovercraft/forward")
    return replace(scenario, duration=seconds(2))


def _with(scenario, supervisor, sensors=None):
    world = replace(scenario.world, sensors={**scenario.world.sensors, **(sensors or {})})
    return replace(scenario, world=world, autopilot=replace(scenario.autopilot, supervisor=supervisor))


@pytest.mark.thorough
def test_automatic_arming_leaves_the_flight_unchanged(flight):
    plain, watched = simulate(flight), simulate(_with(flight, Supervisor(neutral=NEUTRAL_COMMAND, automatic=True)))
    added = [p for p in watched.paths if p not in plain.paths]
    assert added
    assert all(p.startswith("supervisor.") for p in added)
    for path in plain.paths:
        if path.startswith(("truth", "estimate", "actuators", "command.valid")):
            np.testing.assert_array_equal(plain[path], watched[path], err_msg=path)
    assert MODES[int(watched["supervisor.mode"][-1])] == "flying"


@pytest.mark.thorough
def test_flight_modes_follow_the_pilot_requests(flight):
    """No motion before arming; hold is neutral and valid; an end is latched until cleared."""
    asked = pilot_script(
        (ms(300), "arm"), (ms(1000), "hold"), (ms(1400), "end"), (ms(1600), "clear"), (ms(1700), "arm")
    )
    log = simulate(_with(flight, Supervisor(neutral=NEUTRAL_COMMAND), {"pilot": asked}))
    mode = [MODES[int(m)] for m in log["supervisor.mode"]]
    at = {t: mode[t] for t in (250, 900, 1300, 1550, 1680, 1900)}
    wanted = ("standby", "flying", "hold", "ended", "standby", "flying")
    assert tuple(at.values()) == wanted
    valid, speed = log["command.valid"], log["command.value.speed_rpm"]
    assert not valid[:300].any()
    assert speed[600:900].max() > 0
    holding = np.array(mode) == "hold"
    assert valid[holding].all()
    assert (speed[holding] == 0).all()
    assert (log["command.value.rudder_pulse"][holding] == 1.5e-3).all()
    assert not valid[np.array(mode) == "ended"].any()
    assert log["truth.north"][:300].max() == log["truth.north"][0]


@pytest.mark.thorough
def test_speed_envelope_breach_stops_the_craft(flight):
    slow = Limit(fields=("surge_velocity",), high=0.3, kind="envelope")
    log = simulate(_with(flight, Supervisor(neutral=NEUTRAL_COMMAND, automatic=True, limits=(slow,))))
    first = int(np.argmax(log["estimate.state.surge_velocity"] > 0.3))
    assert first > 0
    assert MODES[int(log["supervisor.mode"][first])] == "fault"
    assert CAUSES[int(log["supervisor.cause"][first])] == "speed envelope"
    assert log["command.valid"][first - 1]
    assert not log["command.valid"][first:].any()


def test_supervisor_rejects_an_incompatible_autopilot(flight):
    with pytest.raises(InputError, match="the supervisor can never be armed"):
        simulate(_with(flight, Supervisor(neutral=NEUTRAL_COMMAND)))
    with pytest.raises(InputError, match="no 'altitude'"):
        simulate(
            _with(flight, Supervisor(neutral=NEUTRAL_COMMAND, automatic=True, limits=(Limit(fields=("altitude",)),)))
        )
    with pytest.raises(InputError, match="neutral is a PlanarForce"):
        simulate(_with(flight, Supervisor(automatic=True, neutral=PlanarForce(0.0, 0.0))))


def test_ideal_twin_has_no_supervisor(flight):
    assert _with(flight, Supervisor(neutral=NEUTRAL_COMMAND)).ideal().autopilot.supervisor is None


def test_empty_pilot_script_gives_no_valid_sample():
    state = PilotScript().init(None)
    _, sample = PilotScript().step(np.int64(ms(500)), state, None)
    assert not bool(sample.valid)
    assert not bool(sample.fresh)


@pytest.mark.thorough
@pytest.mark.skipif(find_compiler("c") is None, reason="no C compiler here")
def test_compiled_step_runs_the_supervisor(flight):
    """Modes match the simulation sample by sample for the same requests."""
    flight = _with(
        flight, Supervisor(neutral=NEUTRAL_COMMAND), {"pilot": pilot_script((ms(100), "arm"), (ms(300), "end"))}
    )
    flight = replace(flight, duration=ms(500))
    log = simulate(flight, backend="jax")
    step = compile_autopilot(flight)
    modes = []
    for k in range(len(log)):
        for path, where in step.reads.items():
            step.inputs[where] = (log.ticks if path == "t" else log["downlink" + path.removeprefix("samples")])[k]
        step.step()
        modes.append(step.result("supervisor.mode"))
        assert step.result("command.valid") == log["command.valid"][k]
        assert step.result("supervisor.cause") == log["supervisor.cause"][k]
    np.testing.assert_array_equal(modes, log["supervisor.mode"])
    assert len(set(modes)) == 3

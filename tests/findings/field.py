"""Findings of field tests: the smallest case of each, what happened at first, and what happens.

Each function returns what happens and whether it is right.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from findings.finding import ROOT, Finding, run_tests


def median_far_out() -> tuple[str, bool]:
    """Median of a normal number between 10 and 11 standard deviations."""
    from trimtab.analysis.campaign.sampling.distributions import parse_distribution

    found = float(parse_distribution("truncated(0, 1, 10, 11)").quantile(np.array([0.5]), 1.0)[0])
    return f"{found:.9g}", abs(found - 10.068409369547576) < 1e-9


def percentage_of_a_logarithm() -> tuple[str, bool]:
    """Standard deviation of the logarithm, given in percent."""
    from trimtab.analysis.campaign.sampling.distributions import parse_distribution

    u = np.array([0.5, 0.8413447460685429])
    low, high = np.log(parse_distribution("lognormal(2.6, 5%)").quantile(u, 100.0))
    return f"standard deviation of the logarithm {high - low:.6g}", abs(high - low - 0.05) < 1e-9


def nearly_singular_riccati(scale: float | None) -> tuple[str, bool]:
    """Gain of A = [1 + e, 1; 1, 1 + e] with Q = e^2 I."""
    from trimtab.core.errors import InputError
    from trimtab.design.lqr import lqr

    e = 1e-7
    slow, fast = e * (1 + np.sqrt(2)), 2 + e + np.sqrt((2 + e) ** 2 + e * e)
    exact = np.array([[fast + slow, fast - slow], [fast - slow, fast + slow]]) / 2
    A, Q = [[1 + e, 1], [1, 1 + e]], e * e * np.eye(2)
    try:
        found = lqr(A, np.eye(2), Q, np.eye(2), scale=None if scale is None else scale * np.ones(2))
    except InputError as error:
        return error.problem, False
    off = float(np.abs(-found.K - exact).max())
    return f"largest deviation of the gain {off:.2g}", off < 1e-7


def slow_pole_recorded_wrong() -> tuple[str, bool]:
    """Slow pole of a stiff loop, recorded ten times as large and with the other sign."""
    from trimtab.design.certificate_check import _poles_condition

    poles = np.array([-0.03, -0.05 + 1j, -0.05 - 1j, -5e5])
    condition = _poles_condition(poles, np.array([0.3, *poles[1:]]))
    return condition.why or "accepted", not condition.holds


def control_characters_of_a_file() -> tuple[str, bool]:
    """Name with an escape sequence and a line break, in an error."""
    from trimtab.core.errors import InputError

    text = str(InputError("file 'gain.json'", "has the unknown key", choices=("a\x1b[2J\nproved",)))
    return repr(text), "\x1b" not in text and "\nproved" not in text


def euler_angles_in_single_precision() -> tuple[str, bool]:
    """Angles of a rotation at pitch pi/2, in float32."""
    import jax.numpy as jnp

    from trimtab.core.rotation import from_euler, to_euler

    R = np.asarray(from_euler(-0.7, np.pi / 2, 0.3)).astype(np.float32)
    off = float(np.abs(np.asarray(from_euler(*np.asarray(to_euler(jnp.asarray(R)), float))) - R).max())
    return f"the rebuilt rotation is off by {off:.2g}", off < 1e-5


def survey_from_a_line() -> tuple[str, bool]:
    """Survey of one beacon from a straight path."""
    from trimtab.analysis.identify.beacon_survey import survey_beacons
    from trimtab.core.errors import InputError

    path = np.stack([np.arange(6.0), np.array([0, 5, -3, 4, -2, 1]) * 1e-3], axis=1)
    ranges = np.hypot(np.arange(6.0) - 2.0, np.hypot(3.0, 2.5))[:, None]
    try:
        found = survey_beacons(ranges, np.diff(path, axis=0), range_noise=1e-3, odometry_noise=5e-3)
    except InputError as error:
        return error.problem, True
    return f"beacon at {found.beacons[0]}", False


def read_text_as_csv(text: str, time: str | None = None):
    """Return the log of a CSV file with this text."""
    from trimtab.logs.samples import read_csv

    with TemporaryDirectory() as folder:
        file = Path(folder) / "log.csv"
        file.write_text(text, encoding="utf-8")
        return read_csv(file, time)


def units_of_times() -> tuple[str, bool]:
    """Times in microseconds without a unit, then in the unit of their name."""
    from trimtab.core.errors import InputError

    try:
        read_text_as_csv("timestamp,g\n1000000000,1\n1000005000,2\n")
    except InputError as error:
        refused = error.problem
    else:
        return "read as seconds", False
    files = {"time_ms": "0,1\n5,2\n", "TimeUS": "7000000,1\n7005000,2\n", "%time": "10,1\n5000010,2\n"}
    periods = {name: float(read_text_as_csv(f"{name},g\n{rows}").t[1]) for name, rows in files.items()}
    return f"{refused}; with a unit in the name: {periods} s", set(periods.values()) == {0.005}


def numbered_columns() -> tuple[str, bool]:
    """Names of PX4's columns with an index."""
    log = read_text_as_csv("t,gyro_rad[0],gyro_rad[1],gyro_rad[2]\n0,1,2,3\n1,4,5,6\n")
    found = {path: log.unit(path) for path in log.paths}
    return str(found), found == {f"csv.gyro_rad[{i}]": "1" for i in range(3)}


def unclean_cells() -> tuple[str, bool]:
    """Comment, quoted number, text and empty cell in a file with one clean column."""
    log = read_text_as_csv('# logger 2\nt,mode,gyro,battery\n0,AUTO,"0.5",\n1,HOLD,0.25,12\n')
    reasons = log.metadata.get("left_out")
    text = f"signals {log.paths}, left out {reasons}"
    return text, log.paths == ("csv.gyro",) and "line 3, column 'mode'" in str(reasons)


def lost_sample() -> tuple[str, bool]:
    """An hour at 10 Hz without sample 12 000."""
    from trimtab.core.time import ms, to_seconds
    from trimtab.logs.log import Log
    from trimtab.logs.samples import samples

    ticks = np.delete(np.arange(36_000) * ms(100), 12_000)
    log = Log(t=to_seconds(ticks), ticks=ticks, signals={"csv.gyro": np.zeros(len(ticks))})
    found = samples(log, "csv.gyro", longest=True)
    return f"{len(found.ticks)} samples; {found.left_out}", len(found.ticks) == 23_999 and bool(found.left_out)


def ranges_through_walls() -> tuple[str, bool]:
    """Half of the ranges 2 to 8 m too long; then a vehicle that stands 14 m beside the given start."""
    import jax
    from estimators.odometry_drives import BEACONS, drive, frames_of

    from trimtab.core.rng import key
    from trimtab.estimators.ranging.odometry import OdometryNoise, OdometryRanging, PlanarStart, RadioErrors

    def fly(frames: Any, north: Any) -> Any:
        form = OdometryRanging(
            noise=OdometryNoise(slip=0.05, turn=3e-3, bias_walk=1e-4),
            errors=RadioErrors(noise=0.2, scale=0.05, sigma_scale=0.02, sigma_error=0.1),
            start=PlanarStart(heading=0.3, north=north, east=-2.0),
            beacons=BEACONS,
        )
        return jax.lax.scan(lambda s, f: form.step(f.t, s, f), form.init(key(0)), frames)

    def run(world: Any, north: float) -> tuple[int, Any]:
        state, estimates = program(frames_of(world), north)
        place = np.asarray(estimates.state.north), np.asarray(estimates.state.east)
        return int(state.fix.restarts), np.hypot(place[0] - world.north, place[1] - world.east)

    program, world, rng = jax.jit(fly), drive(3), np.random.default_rng(3)
    wall = world.arrived & (rng.random(world.range.shape) < 0.5)
    longer = world._replace(range=world.range + np.where(wall, rng.uniform(2, 8, wall.shape), 0))
    restarts, off = run(longer, 1.0)
    again, lost = run(drive(4), 15.0)
    rms = float(np.sqrt(np.mean(off**2)))
    text = f"through walls: {restarts} restarts, {rms:.2f} m rms; beside the start: {lost[-1]:.2f} m off at the end"
    return text, restarts == 0 and rms < 0.5 and again == 1 and lost[-1] < 1.0


def heading_sigma() -> tuple[str, bool]:
    """NEES of the heading in 6 runs each of two flights, beside what the page says."""
    from trimtab.logs.navigation import state_series
    from trimtab.run.simulate import simulate_many
    from trimtab.scenarios import catalogue

    found = {}
    for name in ("zero-velocity", "forward"):
        scenario, _ = catalogue.load_scenario(f"hovercraft/{name}", {"navigation": "ins"})
        states = [state_series(log)["heading"] for log in simulate_many(scenario, seeds=range(6))]
        found[name] = float(np.mean([np.mean((s.error / s.sigma)[s.t > 4] ** 2) for s in states]))
    page = (ROOT / "docs/estimators/ultrasonic-inertial.md").read_text(encoding="utf-8")
    text = "a worst case, and the page says so; NEES " + ", ".join(f"{v:.2f} in {k}" for k, v in found.items())
    return text, "deliberate worst case" in page and all(0.1 < nees < 1.3 for nees in found.values())


def long_chains() -> tuple[str, bool]:
    """Certificates of chains of 12 integrators, and of 13 with 4 inputs; and the matrix inequality of 12."""
    from trimtab.core.errors import InputError
    from trimtab.design.certificate import design_certificate
    from trimtab.design.certificate_check import prove_certificate
    from trimtab.design.certified_system import CertifiedSystem
    from trimtab.design.lmi import lmi_gain

    failed = []
    for n, m in ((12, 1), (13, 4)):
        A, I = np.diag(np.ones(n - 1), 1), np.eye(n)
        names = tuple(f"x{i}" for i in range(n)), tuple(f"u{i}" for i in range(m))
        system = CertifiedSystem("chain", {}, "lqr", *names, A, I[:, -m:], I / 1.01, np.eye(m), I, np.ones(n))
        proof = prove_certificate(design_certificate(system), system)
        failed += [f"{n} states, {m} inputs: {c.name}" for c in proof.conditions if not c.holds]
    try:
        text = f"solved: {lmi_gain(np.diag(np.ones(11), 1), np.eye(12)[:, -1:], np.eye(12), 1.0).status}"
    except InputError as error:
        text = f"{error.problem}. {error.fix}"
    right = not failed and "12 states" in text and "lqr" in text
    return f"conditions that fail: {failed or 'none'}; inequality: {text}", right


def slopes_at_corners() -> tuple[str, bool]:
    """Linear models at corners, and beside one."""
    import jax.numpy as jnp

    from trimtab.core.errors import InputError
    from trimtab.design.linearise import linearise
    from trimtab.design.model import model_of_functions

    def slope(h: Any) -> str:
        model = model_of_functions(
            lambda x, u: jnp.stack([x[1], u[0]]), ("x", "v"), ("u",), h=h, outputs=("y",), x0=[0.0, 0.0]
        )
        try:
            return f"C = {linearise(model).C[0].tolist()}"
        except InputError as error:
            return error.problem

    corners = {
        "hypot": slope(lambda x, u: jnp.hypot(x[0], x[1])[None]),
        "abs": slope(lambda x, u: jnp.abs(x[:1])),
        "saturation": slope(lambda x, u: jnp.clip(x[:1] + 1, -1, 1)),
    }
    smooth = slope(lambda x, u: x[:1] * jnp.abs(x[:1]) + x[1:])
    text = "; ".join(f"{name}: {found}" for name, found in (*corners.items(), ("drag", smooth)))
    return text, all("has no slope" in c for c in corners.values()) and smooth == "C = [0.0, 1.0]"


FINDINGS = [
    Finding("A1", "truncated(0, 1, 10, 11), median", "11.0", median_far_out),
    Finding("A2", "lognormal(2.6, 5%) with nominal value 100", "5", percentage_of_a_logarithm),
    Finding("B1", "six pings on a straight line", "(2.0, 0.001, -3.905) m without an error", survey_from_a_line),
    Finding("B3", "half of the ranges through walls", "7.8 m off instead of 0.24 m", ranges_through_walls),
    Finding(
        "B4",
        "particle filter with rejected ranges",
        "valid at 76 m off",
        lambda: run_tests("studies/test_ranges2009_particle.py::test_estimate_is_invalid_while_ranges_are_rejected"),
    ),
    Finding("B5", "to_euler in float32 at pitch pi/2", "rotation off by 0.17 rad", euler_angles_in_single_precision),
    Finding("B6", "heading sigma of --navigation ins", "1.8 times too large without a word", heading_sigma),
    Finding("C1", "timestamps in microseconds", "read as seconds without a word", units_of_times),
    Finding("C2", "columns gyro_rad[0], gyro_rad[1], gyro_rad[2]", "refused as one signal", numbered_columns),
    Finding("C3", "text and empty cells in other columns", "the whole file is refused", unclean_cells),
    Finding("C4", "one lost sample in an hour", "refused", lost_sample),
    Finding("D2", "lqr with Q = 1e-14 I", "gain off by 0.65 %", lambda: nearly_singular_riccati(None)),
    Finding(
        "D3", "the same with scale 1", "the weight Q does not see the pole +2", lambda: nearly_singular_riccati(1.0)
    ),
    Finding("D4", "slow pole of a stiff loop recorded as +0.3", "accepted", slow_pole_recorded_wrong),
    Finding("D6", "systems with 12 states, or 4 inputs", "traceback, or refused", long_chains),
    Finding("D7", "escape sequence in a name", "sent to the terminal as it is", control_characters_of_a_file),
    Finding("D8", "hypot at rest, abs at 0, saturation at its corner", "C = [0.5, 0.5], 1, 0.5", slopes_at_corners),
]

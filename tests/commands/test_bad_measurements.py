"""Mistakes in measurement files, by procedure: each is reported with line and column.

The data are those of the virtual bench, which are fitted as they are, with one thing changed.
"""

import re

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.analysis.identify.virtual_bench import draw_craft, run_bench, write_bench
from trimtab.cli import main
from trimtab.commands.calibrate_inputs import find_geometry
from trimtab.commands.calibrate_link import _find_misfit, _refuse_unchanged
from trimtab.core.errors import InputError
from trimtab.links.latency_trace import Trace

FILES = {
    "rudder": "servo.csv",
    "hull": "hull.csv",
    "thrust": "thrust.csv",
    "reverse": "reverse.csv",
    "inertia": "trials.csv",
    "spin-up": "spin-up.csv",
    "friction": "coast.csv",
    "gyro": "sweep.csv",
    "link": "up.csv",
}
OPTIONS = {"link": ("--way", "up"), "spin-up": ("--force", "1.1 N", "--rudder", "-20 deg")}


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    write_bench(folder, run_bench(draw_craft(3), 3))
    return {name: (folder / file).read_text().splitlines() for name, file in FILES.items()}


def calibrate(procedure, lines, folder, *options):
    file = folder / FILES[procedure]
    file.write_text("\n".join(lines) + "\n")
    verb = "inertia" if procedure == "spin-up" else procedure
    return CliRunner().invoke(main, ["calibrate", verb, str(file), *OPTIONS.get(procedure, ()), *options])


def swap(lines, a, b):
    head = lines[0].split(",")
    head[a], head[b] = head[b], head[a]
    return [",".join(head), *lines[1:]]


def put(lines, line, column, value):
    """The lines with another cell in a line, counted from 1, and column, from 0."""
    cells = lines[line - 1].split(",")
    cells[column] = value
    return [*lines[: line - 1], ",".join(cells), *lines[line:]]


def alter(lines, column, change):
    """The lines with every number of a column changed."""
    rows = [line.split(",") for line in lines[1:]]
    return [lines[0], *(",".join([*r[:column], str(change(float(r[column]))), *r[column + 1 :]]) for r in rows)]


EVERY = {
    "empty": (lambda x: [], "empty"),
    "headings only": (lambda x: x[:1], "no measurement|packets in the file: 0"),
    "a column is missing": (lambda x: [line.partition(",")[2] for line in x], "no column|line 1: the header is"),
    "semicolons and commas": (
        lambda x: [line.replace(",", ";").replace(".", ",") for line in x],
        "line 1 uses semicolons|line 1: the header is",
    ),
    "decimal commas": (
        lambda x: [x[0], *(line.replace(".", ",") for line in x[1:])],
        r"the line .* has 4 fields|line \d+ has|line \d+: fields",
    ),
    "a word": (lambda x: put(x, 8, 1, "n/a"), "line 8.*'n/a'"),
    "not finite": (lambda x: put(x, 8, 1, "nan"), "line 8.*finite"),
    "a line twice": (
        lambda x: [*x[:5], x[4], *x[5:]],
        "lines 5 and 6 are the same|line 6, column 'time'|appears twice",
    ),
    "three lines": (
        lambda x: x[:4],
        "no angle was measured|readings|has 3 readings|no value is above|2 packets arrived|samples are too few",
    ),
}


@pytest.mark.parametrize("procedure", FILES)
@pytest.mark.parametrize("what", EVERY)
def test_every_procedure_rejects_malformed_measurements(procedure, what, bench, tmp_path):
    change, said = EVERY[what]
    done = calibrate(procedure, change(bench[procedure]), tmp_path)
    if what == "three lines" and done.exit_code == 0:
        assert procedure in ("hull", "thrust", "inertia")  # one or two numbers: the interval says how little that is
        return
    assert done.exit_code == 2, done.output
    assert re.search(said, done.output), done.output
    assert "Fix: " in done.output
    assert "Traceback" not in done.output


OWN = {
    "rudder and hull swapped": ("hull", lambda x: swap(x, 0, 1), "'rudder' and 'hull' are swapped"),
    "force and speed swapped": ("thrust", lambda x: swap(x, 1, 2), "line 2, column 'force'.*order of the headings"),
    "forward and reverse swapped": (
        "reverse",
        lambda x: swap(x, 1, 2),
        "reverse thrust exceeds forward.* in lines 2,",
    ),
    "force and slope swapped": ("inertia", lambda x: swap(x, 1, 2), "'force' and 'slope' are swapped"),
    "reference and gyro swapped": ("gyro", lambda x: swap(x, 1, 2), "the same axis, the same sign"),
    "time and rate swapped": ("friction", lambda x: swap(x, 0, 1), "trial '1', line 3, column 'time'.*swapped"),
    "degrees under radians": ("friction", lambda x: put(x, 1, 1, "yaw_rate [deg/s]"), "no value is above"),
    "grams under newtons": (
        "thrust",
        lambda x: alter(x, 2, lambda force: 102 * force),
        "column 'force'.*is outside -0.5 to 100 N",
    ),
    "a spike": ("spin-up", lambda x: put(x, 8, 1, "3"), "line 8, column 'yaw_rate': 3 is"),
    "a spike in a coast-down": ("friction", lambda x: put(x, 40, 1, "9"), "line 40, column 'yaw_rate': 9 is"),
    "two spikes": ("friction", lambda x: put(put(x, 40, 1, "9"), 60, 1, "-8"), "other such readings: lines 40 and 60"),
    "a wrong sample of a gyro": ("gyro", lambda x: put(x, 900, 2, "4"), "line 900: the gyro deviates by"),
    "a run under another's number": (
        "friction",
        lambda x: [x[0], *(line.rpartition(",")[0] + ",1" for line in x[1:])],
        "trial '1', line 242, column 'time'",
    ),
    "saturated gauge in reverse": (
        "reverse",
        lambda x: alter(x, 2, lambda force: min(force, 0.4)),
        "column 'reverse' is 0.4 in each line",
    ),
    "rudder across the stream": (
        "thrust",
        lambda x: alter(x, 0, lambda angle: 90),
        r"line 2, column 'rudder' \(rudder angle\): 90 deg is outside -60 to 60 deg",
    ),
    "radians under degrees": (
        "thrust",
        lambda x: alter(x, 0, lambda angle: angle / 57.3),
        "column 'rudder' has 9 angles, but all are within 1.4°",
    ),
    "a force against the thrust": (
        "thrust",
        lambda x: alter(x, 2, lambda force: -force / 10),
        "column 'force' is negative",
    ),
    "a gauge that sticks": (
        "thrust",
        lambda x: alter(x, 2, lambda force: 0.5),
        "at equal rudder angles the force changes by 0|saturated",
    ),
    "a spin and a glide": (
        "friction",
        lambda x: put(x, 1, 2, "speed [m/s]"),
        "both a column 'yaw_rate' and a column 'speed'",
    ),
    "microseconds under seconds": (
        "spin-up",
        lambda x: alter(x, 0, lambda time: 1e-3 * time),
        "column 'time': the readings are 2e-05 s apart, must be 0.0001 to 2 s",
    ),
    "a sweep in milliseconds": ("gyro", lambda x: alter(x, 0, lambda time: 1e3 * time), "are 6.5536 s apart"),
    "a gyro of the other sign": (
        "gyro",
        lambda x: alter(x, 2, lambda rate: -rate),
        "the static gain of the gyro must be 0.5 to 2, got -1",
    ),
    "a gyro of three times the rate": (
        "gyro",
        lambda x: alter(x, 2, lambda rate: 3 * rate),
        "the static gain of the gyro must be 0.5 to 2, got 3",
    ),
    "a gyro of a fifth of the rate": (
        "gyro",
        lambda x: alter(x, 2, lambda rate: rate / 5),
        "the static gain of the gyro must be 0.5 to 2, got 0.2",
    ),
    "angles of hundredths of a degree": (
        "hull",
        lambda x: alter(x, 0, lambda angle: angle / 100),
        r"no value is above 0\.\d+ deg",
    ),
    "latencies of nanoseconds": (
        "link",
        lambda x: [x[0], *(f"{a},{1e-9 * float(b) if b else ''}" for a, b in (line.split(",") for line in x[1:]))],
        "the median latency must be between 1 us and 5 s",
    ),
    "latencies of ten seconds": (
        "link",
        lambda x: [x[0], *(f"{a},{200 * float(b) if b else ''}" for a, b in (line.split(",") for line in x[1:]))],
        "the median latency must be between 1 us and 5 s",
    ),
    "milliradians under radians": ("inertia", lambda x: alter(x, 2, lambda slope: 1e-3 * slope), "column 'slope'"),
    "milliseconds under seconds": (
        "friction",
        lambda x: alter(x, 0, lambda time: 1e3 * time),
        "the readings are 50 s apart",
    ),
    "equal latencies": (
        "link",
        lambda x: alter([line for line in x if line[-1] != ","], 1, lambda latency: 0.03),
        "latency_s is 0.03 in each line",
    ),
    "clocks that drift": (
        "link",
        lambda x: [
            x[0],
            *(f"{a},{float(a) / 10 + float(b) if b else ''}" for a, b in (line.split(",") for line in x[1:])),
        ],
        "the latencies change with sent_s",
    ),
    "milliseconds": (
        "link",
        lambda x: [x[0], *(f"{a},{1e3 * float(b) if b else ''}" for a, b in (line.split(",") for line in x[1:]))],
        "check the unit",
    ),
}


@pytest.mark.thorough("reference and gyro swapped")
@pytest.mark.parametrize("what", OWN)
def test_procedure_rejects_its_own_invalid_measurements(what, bench, tmp_path):
    procedure, change, said = OWN[what]
    done = calibrate(procedure, change(bench[procedure]), tmp_path)
    assert done.exit_code == 2, done.output
    assert re.search(said, done.output, re.DOTALL), done.output


NAMED = {
    "outlier in angle": ("rudder", lambda x: put(x, 8, 1, "12"), "left out: line 8, column 'angle'"),
    "outlier in force": ("thrust", lambda x: put(x, 8, 2, "3"), "left out: line 8, column 'force'"),
    "outlier in slope": ("inertia", lambda x: put(x, 8, 2, "9"), "left out: line 8, column 'slope'"),
    "one rudder angle": ("thrust", lambda x: x[:9], "the data has only rudder angles of -40°"),
    "two routes": (
        "link",
        lambda x: alter([line for line in x if line[-1] != ","], 1, lambda latency: 0.3 if latency > 0.05 else 0.03),
        "do not follow the fitted distribution",
    ),
    "delayed packet": ("link", lambda x: put(x, 8, 1, "3.6"), "sent at 0.6 s took 3.6 s"),
}


@pytest.mark.parametrize("what", NAMED)
def test_doubtful_measurements_are_fitted_and_reported(what, bench, tmp_path):
    procedure, change, said = NAMED[what]
    done = calibrate(procedure, change(bench[procedure]), tmp_path)
    assert done.exit_code == 0, done.output
    assert said in " ".join(done.output.split())


@pytest.mark.parametrize("procedure", FILES)
def test_valid_measurements_are_fitted_without_remarks(procedure, bench, tmp_path):
    """A comment above the data is accepted, except in a recording of `link`. No outlier is reported."""
    lines = bench[procedure] if procedure == "link" else ["# an afternoon", *bench[procedure]]
    done = calibrate(procedure, lines, tmp_path)
    assert done.exit_code == 0, done.output
    assert "left out" not in done.output


OPTION = {
    "no division": ("reverse", ("--division", "0 N"), "--division: must be above 0, got 0 N"),
    "a mass below zero": ("friction", ("--mass", "-2 kg"), "--mass: must be above 0, got -2 kg"),
    "a mass of a spin": ("friction", ("--mass", "2.6 kg"), "--mass: is only for a glide"),
    "no arm": ("inertia", ("--arm", "0 m"), "--arm: must be above 0, got 0 m"),
    "no force": ("spin-up", ("--force", "0 N"), "--force: must not be 0, got 0 N"),
    "a rudder across to the right": (
        "spin-up",
        ("--rudder", "61 deg"),
        "--rudder: must be between -60 and 60 deg, got 61 deg",
    ),
    "a rudder across": ("spin-up", ("--rudder", "-120 deg"), "--rudder: must be between -60 and 60 deg, got -120 deg"),
}


@pytest.mark.parametrize("what", OPTION)
def test_procedure_rejects_implausible_options(what, bench, tmp_path):
    procedure, options, said = OPTION[what]
    done = calibrate(procedure, bench[procedure], tmp_path, *options)
    assert done.exit_code == 2, done.output
    assert said in done.output


def test_inertia_names_the_options_that_a_log_needs_and_a_table_must_not_have(bench, tmp_path):
    log, table = tmp_path / "log.csv", tmp_path / "table.csv"
    log.write_text("\n".join(bench["spin-up"]) + "\n")
    table.write_text("\n".join(bench["inertia"]) + "\n")
    done = CliRunner().invoke(main, ["calibrate", "inertia", str(log)])
    assert done.exit_code == 2, done.output
    assert "is the log of one spin-up; it needs --force" in done.output
    done = CliRunner().invoke(main, ["calibrate", "inertia", str(table), "--force", "1 N", "--rudder", "-20 deg"])
    assert done.exit_code == 2, done.output
    assert "is only for a log, but file" in done.output


def test_friction_reads_headings_below_a_comment_and_in_capitals(tmp_path):
    rows = [f"{0.1 * k},{3 - 0.1 * k}" for k in range(20)]
    done = calibrate(
        "friction", ["# a glide", "time [s],Speed [m/s],wheel speed [rpm]", *(f"{r},5" for r in rows)], tmp_path
    )
    assert done.exit_code == 0, done.output
    assert "Friction.force_coulomb" in done.output
    assert "Hovercraft.mass is not calibrated; the fit uses the value of the thesis, 2.6" in done.output


@pytest.mark.parametrize("procedure", ["thrust", "friction"])
def test_file_in_another_encoding_is_rejected(procedure, bench, tmp_path):
    file = tmp_path / "data.csv"
    file.write_bytes("\n".join(bench[procedure]).encode("utf-16"))
    done = CliRunner().invoke(main, ["calibrate", procedure, str(file)])
    assert done.exit_code == 2, done.output
    assert "cannot be read as text" in done.output


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ('value = 0.57\nunit = "deg"', "must be a number with the unit 'rad', got 0.57 with the unit 'deg'"),
        ('value = [1.0, 2.0]\nunit = "rad"', "must be a number with the unit 'rad', got [1.0, 2.0]"),
    ],
)
def test_edited_result_of_an_earlier_procedure_is_rejected(entry, said, bench, tmp_path):
    (tmp_path / "boat.toml").write_text(f'version = 1\n["Thruster.offset"]\n{entry}\n')
    done = calibrate("thrust", bench["thrust"], tmp_path, "--out", str(tmp_path / "boat.toml"))
    assert done.exit_code == 2, done.output
    assert said in done.output


def test_edited_inertia_below_zero_is_rejected(bench, tmp_path):
    (tmp_path / "boat.toml").write_text('version = 1\n["Hovercraft.inertia"]\nvalue = -0.1\nunit = "kg m^2"\n')
    done = calibrate("friction", bench["friction"], tmp_path, "--out", str(tmp_path / "boat.toml"))
    assert done.exit_code == 2, done.output
    assert "Hovercraft.inertia: must be above 0 kg m^2, got -0.1" in done.output


def test_calibration_file_in_another_encoding_is_rejected(bench, tmp_path):
    (tmp_path / "boat.toml").write_bytes(b"# \xf6\nversion = 1\n")
    done = calibrate("hull", bench["hull"], tmp_path, "--out", str(tmp_path / "boat.toml"))
    assert done.exit_code == 2, done.output
    assert "cannot be read" in done.output


SENT = 0.02 * np.arange(3000.0)
JITTER = 1e-3 * np.random.default_rng(0).standard_normal(3000)


@pytest.mark.parametrize(
    ("latency", "said"),
    [
        (0.02 + JITTER + 1e-4 * SENT, "the latencies change with sent_s, from 0.0202 s .* to 0.0256 s"),
        (0.03 + JITTER - 1e-4 * SENT, "the latencies change with sent_s"),
        (0.02 + JITTER + 5e-5 * SENT, ""),
        (0.02 + 0.05 * JITTER + 2e-5 * SENT, ""),  # change of 1.2 ms: correlation 0.99, but 6 % of the latency
        (np.full(3000, 0.02), "latency_s is 0.02 in each line"),
    ],
)
def test_rejects_a_trend_of_the_latency_but_no_small_drift_of_the_clock(latency, said):
    trace = Trace(SENT, latency, np.zeros(3000, bool))
    if not said:
        _refuse_unchanged("file 'up.csv'", trace)
        return
    with pytest.raises(InputError, match=said):
        _refuse_unchanged("file 'up.csv'", trace)


def test_rejects_packets_that_were_all_sent_at_one_time():
    with pytest.raises(InputError, match="sent_s is 1 in each line"):
        _refuse_unchanged("file 'up.csv'", Trace(np.ones(50), 0.02 + JITTER[:50], np.zeros(50, bool)))


def test_resolution_of_the_clock_is_no_misfit_of_the_latencies():
    exact = np.sort(0.02 + 0.2 * JITTER)
    shares = (np.arange(3000) + 0.5) / 3000
    assert _find_misfit(exact, exact, shares) < 1e-3
    assert _find_misfit(np.round(exact, 3), exact, shares) < 0.01
    assert _find_misfit(exact, exact + 2e-4, shares) == pytest.approx(0.38, abs=0.03)  # a shift by one deviation
    assert _find_misfit(np.where(shares < 0.7, 0.02, 0.3), exact, shares) > 0.25


def test_latencies_of_a_polled_link_are_fitted_without_remarks(tmp_path):
    latency = 0.005 + 0.05 * np.random.default_rng(0).random(400)
    lines = ["sent_s,latency_s", *(f"{0.02 * k:.2f},{value:.6f}" for k, value in enumerate(latency))]
    done = calibrate("link", lines, tmp_path)
    assert done.exit_code == 0, done.output
    assert "do not follow" not in done.output


def test_ratio_of_a_rudder_is_used_without_its_offset(tmp_path):
    file = tmp_path / "boat.toml"
    file.write_text('version = 1\n["RudderGeometry.ratio"]\nvalue = 1.3\nunit = "1"\nstandard_error = 0.01\n')
    geometry = find_geometry(file, 0.2)
    assert geometry.ratio == 1.3
    assert not np.any(geometry.covariance)
    file.write_text('version = 1\n["RudderGeometry.ratio"]\nvalue = 0.0\nunit = "1"\n')
    with pytest.raises(InputError, match="must be above 0, got 0"):
        find_geometry(file, 0.2)

"""The benchmarks run and their results agree. No test asserts a speed."""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
needs_compilers = pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("g++")), reason="no gcc, g++")


def loaded(name):
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def python(*arguments, **options):
    done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True, **options)
    return done


def printed_numbers():
    """The 14 numbers of benchmarks/README.md."""
    block = (BENCHMARKS / "README.md").read_text(encoding="utf-8").split("```")[-2]
    return np.array([float(x) for x in block.split()])


@pytest.mark.thorough
@needs_compilers
def test_compared_programs_agree_in_results(tmp_path):
    done = python(BENCHMARKS / "compare.py", "--quick", "--json", tmp_path / "found.json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all results agree to 1e-09" in done.stdout
    found = json.loads((tmp_path / "found.json").read_text())
    worst = {(table, name): d for table, timed in found["tables"].items() for name, d in timed["worst"].items()}
    assert max(worst.values()) <= 1e-9
    for table, programs in {
        "single": ("hand-written C", "hand-written C with SLP", "trimtab C"),
        "python": ("trimtab C", "JAX scan", "trimtab on JAX", "numpy loop"),
        "log": ("hand-written C", "trimtab C", "JAX scan", "trimtab on JAX"),
        "campaign": ("hand-written C", "trimtab with lanes and threads", "JAX vmap"),
    }.items():
        assert {(table, name) for name in programs} <= set(worst)
    assert {r["target"] for r in found["ratios"].values()} == {"≤ 1.1", "≥ 0.95", "≥ 8", "≥ 20", "≤ 1.3", ""}


@pytest.mark.thorough
@needs_compilers
def test_comparison_names_wrong_program():
    text = """
import sys, tempfile
sys.path.insert(0, sys.argv[1])
import compare, references
from paired import Timed
timed = Timed({}, {}, {"hand-written C": 0.0, "right": 1e-12, "wrong": 1e-6, "not a number": float("inf")})
with tempfile.TemporaryDirectory() as folder:
    libraries = references.hand(folder, "native")
    print(compare.wrong({"single": timed}, libraries, 1e-9))
    references.KNOWN[3] += 1e-6
    print(compare.wrong({}, libraries, 1e-9))
"""
    done = python("-c", text, BENCHMARKS)
    assert done.stdout.splitlines() == ["['wrong (one run)', 'not a number (one run)']", "['hand-written C']"], (
        done.stderr
    )


@pytest.mark.thorough
@needs_compilers
def test_filters_in_c_numpy_and_filterpy_agree():
    done = python(BENCHMARKS / "filters.py", "--quick")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("all results agree to 1e-09") == 2
    there = importlib.util.find_spec("filterpy") is not None
    assert ("filterpy" in done.stdout) == there
    assert ('pip install "trimtab[bench]"' in done.stderr) != there


@pytest.mark.thorough
@needs_compilers
def test_wrong_filter_fails_the_benchmark():
    text = """
import sys
sys.path.insert(0, sys.argv[1])
sys.argv = ["filters.py", "--quick"]
import filters
right = filters.filters_np.Kalman.predict
filters.filters_np.Kalman.predict = lambda self, F, Q: right(self, F, 1.000001 * Q)
sys.exit(filters.main())
"""
    done = python("-c", text, BENCHMARKS)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "WRONG by more than 1e-09: trimtab C" in done.stdout


def test_hand_written_c_is_checked_against_python_definition():
    text = (BENCHMARKS / "references.py").read_text(encoding="utf-8")
    known = [float(x) for x in re.findall(r"-?\d+\.\d{8,}", text.split("KNOWN")[1].split('"""')[0])]
    np.testing.assert_array_equal(known, printed_numbers())


def test_ratios_are_paired_per_round_and_differences_include_nan():
    paired = loaded("paired")
    timed = paired.Timed({}, {"a": [1.0, 20.0, 6.0], "b": [1.0, 10.0, 2.0], "none": []}, {})
    assert paired.ratio(timed, "a", "b") == (2.0, 1.0, 3.0)
    assert paired.ratio(timed, "a", "none") is None
    assert paired.difference([1.0, 2.0], [1.0, 2.5]) == 0.5
    assert paired.difference([1.0, np.nan], [1.0, 2.0]) == np.inf
    assert paired.difference([1.0], [1.0, 1.0]) == np.inf


def test_rounds_shuffle_the_order_and_give_each_program_its_own_copy():
    paired = loaded("paired")
    order = []

    def program(name):
        def call(x):
            order.append(name)
            x += 1.0
            return x

        return call

    names = ("a", "b", "c")
    inputs = [(np.array([float(i)]),) for i in range(9)]
    timed = paired.rounds({n: paired.Program(program(n), runs=2) for n in names}, inputs, "a")
    turns = [tuple(order[i : i + 3]) for i in range(0, len(order), 3)]
    assert len(turns) == 9
    assert all(sorted(t) == ["a", "b", "c"] for t in turns)
    assert len(set(turns)) > 1
    assert timed.worst == dict.fromkeys(names, 0.0)
    assert {len(t) for t in timed.times.values()} == {8}
    assert [float(x[0][0]) for x in inputs] == list(range(9))


def test_repeated_short_program_returns_first_result_and_run_count():
    paired = loaded("paired")
    keys = []

    def call(gains, key):
        keys.append(key.tolist())
        return gains * key[1]

    program = paired.several(call, 3)
    assert program.call(np.array([2.0]), np.array([7, 5], np.uint32)) == [10.0]
    assert (keys, program.runs) == ([[7, 5], [7, 6], [7, 7]], 3)


@pytest.mark.thorough
def test_peer_worker_result_matches_python_definition():
    asked = json.dumps(["peer", [1.0, 2.5], [7, 0]]) + "\n"
    done = python(BENCHMARKS / "peers" / "worker.py", "hover_np", input=asked)
    about, answer = map(json.loads, done.stdout.splitlines())
    assert f"numpy {np.__version__}" in about
    np.testing.assert_allclose(answer, printed_numbers(), rtol=0, atol=1e-9)


def test_every_command_of_the_benchmark_page_exists():
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    named = set(re.findall(r"python (benchmarks/[\w/]+\.py)", page))
    assert {"benchmarks/compare.py", "benchmarks/instructions.py", "benchmarks/peers/run.py"} <= named
    assert [name for name in named if not (ROOT / name).is_file()] == []


@pytest.mark.thorough
@needs_compilers
@pytest.mark.skipif(not shutil.which("valgrind"), reason="no valgrind")
def test_instruction_counts_require_agreeing_results():
    done = python(BENCHMARKS / "instructions.py")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all results agree to 1e-09" in done.stdout


@pytest.mark.thorough
@needs_compilers
def test_deadline_benchmark_times_flight_with_and_without_log():
    done = python(BENCHMARKS / "deadlines.py", "--quick", "--markdown")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len([line for line in lines if line.startswith("| real time, 1 kHz")]) == 2
    for name in ("with log", "without"):
        rows = [line.split() for line in lines if line.startswith(f"  1 {name}")]
        assert len(rows) == 3


@pytest.mark.thorough
@needs_compilers
def test_simulate_is_timed_against_its_c_function():
    done = python(BENCHMARKS / "simulate.py", "--rounds", "1", "--markdown")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = [line for line in done.stdout.splitlines() if "time of simulate / time of its C function" in line]
    assert len([line for line in lines if "≤ 1.3" in line]) == 2


@needs_compilers
@pytest.mark.thorough
def test_campaign_is_timed_against_one_simulator_call():
    done = python(BENCHMARKS / "campaign.py", "--quick", "--markdown")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all rows are equal" in done.stdout
    lines = [line for line in done.stdout.splitlines() if line.startswith("| campaign")]
    assert len(lines) == 3
    assert re.search(r"100: \d+ MB, 300: \d+ MB", lines[1])


@pytest.mark.thorough
@needs_compilers
def test_foreign_functions_compile_as_listed():
    pytest.importorskip("jaxlie")
    done = python(BENCHMARKS / "foreign.py", "--quick", "--library", "jaxlie", "--markdown")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all as listed" in done.stdout
    assert "| functions of other libraries: compiled | 13 of 13 |" in done.stdout

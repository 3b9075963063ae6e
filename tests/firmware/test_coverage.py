"""The firmware's entry under coverage-guided fuzzing: lives of a vehicle, found by what of the code they reach.

`coverage.txt` holds the inputs that reached something new, one a line; by hand, for longer, and to keep what it finds:

    python tests/firmware/test_coverage.py SECONDS
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from firmware.host import KEY

from trimtab.flight.boards.firmware_folder import write_firmware
from trimtab.scenarios import catalogue

pytestmark = pytest.mark.sanitizer

HERE = Path(__file__).parent
CORPUS = HERE / "coverage.txt"
LONGEST = 160
RUNS = 1_000_000
CLANG = ["clang", "-std=c99", "-O2", "-g", "-ffp-contract=off", "-fwrapv"]
CHECKS = ["-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]


def build_fuzzer(written, output):
    """Portable part and exported blocks, without the emulated world; None where clang has no libFuzzer here."""
    folder = written.folder
    sources = [
        HERE / "coverage.c",
        HERE / "power.c",
        *sorted((folder / "portable").glob("*.c")),
        folder / "drive" / "drive.c",
    ]
    sources += [folder / "exported" / f"{name}.c" for name in ("command", "failsafe", "identity", "speed_regulator")]
    include = [f"-I{folder / part}" for part in ("portable", "drive", "exported")] + [
        "-isystem",
        str(folder / "mavlink"),
    ]
    command = [*CLANG, *CHECKS, *include, *map(str, sources), "-lm", "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True) if shutil.which("clang") else None
    if done is None or (done.returncode != 0 and "libclang_rt" in done.stderr):
        return None
    assert done.returncode == 0, done.stderr
    return output


def unpack(folder):
    """The kept inputs as the fuzzer wants them: a file each."""
    folder.mkdir(exist_ok=True)
    for k, line in enumerate(CORPUS.read_text("ascii").split()):
        (folder / str(k)).write_bytes(bytes.fromhex(line))
    return folder


def run_fuzzer(fuzzer, folder, *options):
    """What it said, and its exit status.

    Its limit of resident memory counts what the process was forked from, gigabytes of tests; allocations are limited.
    """
    memory = ["-rss_limit_mb=0", "-malloc_limit_mb=64"]
    command = [str(fuzzer), f"-max_len={LONGEST}", "-print_final_stats=1", "-seed=1", *memory, *options]
    done = subprocess.run(command, cwd=folder.parent, capture_output=True, text=True)
    return done.returncode, done.stderr


@pytest.fixture(scope="session")
def coverage_fuzzer(written, tmp_path_factory):
    """Build the fuzzer. Without libFuzzer the test is skipped; where TRIMTAB_CI_TOOLS is set, it fails."""
    fuzzer = build_fuzzer(written, tmp_path_factory.mktemp("coverage") / "fuzzer")
    if fuzzer is None:
        assert "TRIMTAB_CI_TOOLS" not in os.environ
        pytest.skip("needs clang and libFuzzer, Debian's clang and libclang-rt-14-dev")
    return fuzzer


@pytest.mark.timeout(1200)
@pytest.mark.thorough
def test_fuzzed_outputs_stay_within_limits_and_safe_without_command(coverage_fuzzer, tmp_path):
    status, text = run_fuzzer(coverage_fuzzer, unpack(tmp_path / "corpus"), f"-runs={RUNS}", str(tmp_path / "corpus"))
    print(*re.findall(r"^(?:Done .*|#\d+\s+(?:INITED|DONE).*)$", text, re.MULTILINE), sep="\n")
    assert status == 0, text[-4000:]


@pytest.mark.thorough
def test_fuzzer_corpus_detects_broken_failsafe(coverage_fuzzer, written, tmp_path):
    """The kept inputs alone detect a failsafe that does not stop the fan at once."""
    broken = tmp_path / "firmware"
    shutil.copytree(written.folder, broken)
    for part, text in (("portable/vehicle.c", " || stop"), ("drive/drive.c", "if (!out->command.valid) d->duty = 0;")):
        source = broken / part
        assert text in source.read_text()
        source.write_text(source.read_text().replace(text, ""))
    fuzzer = build_fuzzer(written._replace(folder=broken), tmp_path / "fuzzer")
    status, said = run_fuzzer(fuzzer, unpack(tmp_path / "corpus"), "-runs=0", str(tmp_path / "corpus"))
    assert status != 0
    assert "does not hold" in said


def main():
    """Fuzz for so many seconds on what is kept, and keep the fewest inputs that reach as much."""
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        scenario, _ = catalogue.load_scenario("hovercraft/forward", {})
        fuzzer = build_fuzzer(write_firmware(scenario, scratch / "firmware", KEY), scratch / "fuzzer")
        corpus, least = unpack(scratch / "corpus"), scratch / "least"
        least.mkdir()
        status, text = run_fuzzer(fuzzer, corpus, f"-max_total_time={sys.argv[1]}", str(corpus))
        print(text[-3000:])
        if status == 0:
            run_fuzzer(fuzzer, corpus, "-merge=1", str(least), str(corpus))
            lines = sorted((path.read_bytes().hex() for path in least.iterdir()), key=lambda h: (len(h), h))
            CORPUS.write_text("\n".join(filter(None, lines)) + "\n", "ascii")


if __name__ == "__main__":
    main()

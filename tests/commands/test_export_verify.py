"""`trimtab export --verify`: other options are applied or rejected, never ignored."""

import json
import shutil

import pytest
from click.testing import CliRunner

from trimtab.cli import main

NAME = "hovercraft/zero-velocity"
needs_board = pytest.mark.skipif(
    not (shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm")), reason="no emulated board here"
)


def call(*words):
    return CliRunner().invoke(main, ["export", *map(str, words)])


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """An exported folder, and the JSON result of its export."""
    out = tmp_path_factory.mktemp("export") / "c"
    done = call(NAME, "--out", out, "--steps", 200, "--json")
    assert done.exit_code == 0, done.output
    return out, json.loads(done.stdout)


@pytest.fixture
def folder(written):
    return written[0]


def test_exported_folder_verifies_and_changed_source_fails(written, tmp_path):
    folder, result = written
    assert (result["part"], result["real"]) == ("autopilot", "double")
    assert any(f.endswith("autopilot.c") for f in result["files"])
    done = call("--verify", folder)
    assert done.exit_code == 0, done.output
    assert "same outputs" in done.stdout
    source = shutil.copytree(folder, tmp_path / "changed") / "autopilot.c"
    source.write_text(source.read_text().replace("p->law.k1 = ", "p->law.k1 = 2 * "))
    done = call("--verify", source.parent, "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["good"] is False


@pytest.mark.parametrize(
    "more", [(NAME,), ("--float", "single"), ("--fly",), ("--part", "loop"), ("--out", "x"), ("--steps", "5")]
)
def test_verify_rejects_options_for_writing(more, folder):
    done = call("--verify", folder, *more)
    assert done.exit_code != 0
    word = "a scenario" if more[0] == NAME else more[0]
    assert f"{word} is only for writing" in (done.output + str(done.exception))


def test_rejects_board_target_for_folder_not_exported_for_a_board(folder, tmp_path):
    other = tmp_path / "elsewhere"
    shutil.copytree(folder, other)
    (other / "autopilot.c").rename(other / "other.c")
    done = call("--verify", other, "--target", "cortex-m7")
    assert done.exit_code != 0
    assert "was not exported for a board" in (done.output + str(done.exception))


@pytest.mark.thorough
@needs_board
def test_test_vectors_run_on_target_board(folder):
    plain = json.loads(call("--verify", folder, "--json").output)
    assert "board" not in plain
    there = json.loads(call("--verify", folder, "--target", "cortex-m7", "--json").output)
    assert there["board"]["target"] == "cortex-m7"
    assert there["board"]["instructions_per_step"]["median"] > 100
    assert there["board"]["first_difference"] is None


@pytest.mark.thorough
@needs_board
def test_difference_on_board_fails_verification(folder, tmp_path):
    wrong = tmp_path / "wrong"
    shutil.copytree(folder, wrong)
    lines = (wrong / "vectors.csv").read_text().splitlines()
    cells = lines[3].split(",")
    cells[-1] = repr(float(cells[-1]) + 1.0)
    (wrong / "vectors.csv").write_text("\n".join([*lines[:3], ",".join(cells), *lines[4:]]) + "\n")
    assert call("--verify", wrong, "--target", "cortex-m7").exit_code != 0

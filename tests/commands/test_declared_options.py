"""Options parsed from a verb's source file equal those of the imported verb, so a typo is reported without JAX."""

import subprocess
import sys

import click
import pytest

from trimtab.cli import VERBS, main
from trimtab.commands import declared_options, options
from trimtab.commands.declared_options import parse_words
from trimtab.commands.verbs import find_file, read_help
from trimtab.core.errors import InputError

READ = ("list", "run", "campaign", "falsify", "map", "tune", "fly", "export", "budget", "rare")
TYPOS = (
    "run hovercraft/spinn",
    "run --seed 3 hovercraft/spinn",
    "run hovercraft/spin --plto a.png",
    "run hovercraft/spin --duration",
    "run hoverkraft",
    "run mine.py",
    "list typo",
    "fly hovercraft/forwrd --link udp://127.0.0.1:9",
    "fly hovercraft/forward --lnk udp://127.0.0.1:9",
    "campaign hovercraft/spinn",
    "campaign hovercraft/spin --rnus 5",
    "campaign hovercraft/spin --runs 5e9",
    "run hovercraft/spin --seed one",
    "map hovercraft/spin --depth 90",
    "campaign hovercraft/spin --set wrld.vehicle.mass=3",
)
ANSWERS = """
import sys
from click.testing import CliRunner
from trimtab.cli import main
for line in sys.argv[1:]:
    done = CliRunner().invoke(main, line.split())
    assert done.exit_code == 2, (line, done.output, done.exception)
    assert "Fix:" in done.output, (line, done.output)
    assert "jax" not in sys.modules, line
"""


def parse(verb, words):
    return parse_words(find_file(verb), verb, read_help(verb), words, click.Context(main))


@pytest.mark.thorough("campaign", "falsify", "map", "tune", "fly", "export", "budget", "rare")
@pytest.mark.parametrize("verb", READ)
def test_parsed_options_equal_those_of_imported_verb(verb):
    read = declared_options._read_command(find_file(verb), verb, "")
    own = main.get_command(click.Context(main), verb)
    assert [(p.name, p.opts, p.secondary_opts) for p in read.params] == [
        (p.name, p.opts, p.secondary_opts) for p in own.params
    ]
    assert [p.nargs for p in read.params] == [p.nargs for p in own.params]
    assert [getattr(p, "is_flag", None) for p in read.params] == [getattr(p, "is_flag", None) for p in own.params]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_accepts_help(verb):
    assert parse(verb, ["--help"]) in ([], None)


def test_parse_returns_arguments_that_are_not_options():
    words = ["--seed", "3", "hovercraft/spin", "--no-ideal", "--set", "a=b"]
    assert parse("run", words) == ["hovercraft/spin"]


def test_command_group_is_not_parsed_before_import():
    assert parse("calibrate", ["--nothing"]) is None


@pytest.mark.parametrize("words", [["hovercraft/spin", "--plto", "a.png"], ["hovercraft/spin", "--plot"]])
def test_rejects_unknown_options_and_missing_values(words):
    with pytest.raises(click.UsageError):
        parse("run", words)


def test_typo_is_reported_without_importing_jax(tmp_path):
    (tmp_path / "mine.py").write_text("")
    done = subprocess.run([sys.executable, "-c", ANSWERS, *TYPOS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("typed", "number"), [("1e4", 10_000), ("20", 20), ("5.0", 5)])
def test_count_accepts_power_of_ten_notation(typed, number):
    assert options.Count(1, options.MOST_RUNS).convert(typed, None, None) == number


@pytest.mark.parametrize("typed", ["5e9", "many", "2.5", "0", "nan", "inf"])
def test_count_out_of_range_is_rejected_with_message(typed):
    with pytest.raises(InputError, match=f"must be a whole number from 1 to 10000000, got {typed}"):
        options.Count(1, options.MOST_RUNS).convert(typed, None, None)


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        ("export", ["hovercraft/spin", "--target", "cortex-m7"]),
        ("export", ["hovercraft/spin", "--float", "single"]),
        ("run", ["hovercraft/spin", "--log-period", "1 ms"]),
        ("campaign", ["hovercraft/spin", "--runs", "1e4"]),
        ("falsify", ["hovercraft/spin", "--runs", "100"]),
        ("map", ["hovercraft/spin", "--depth", "3"]),
    ],
)
def test_values_of_choices_are_validated_by_the_verb(verb, words):
    """Choices that a verb imports are unknown to the parser."""
    assert parse(verb, words) == words[:1]

"""Front pages are correct: README, tutorial, references, claims, messages, glossary."""

import importlib.util
import inspect
import re
import shlex
from functools import cache
from pathlib import Path

import click
import pytest

import trimtab
from trimtab.cli import main

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CHAPTERS = sorted((DOCS / "tutorial").glob("*.md"))
THEORY = sorted((DOCS / "theory").glob("*.md"))

spec = importlib.util.spec_from_file_location("reference_pages", DOCS / "reference_pages.py")
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


def read(page):
    return (DOCS / page).read_text(encoding="utf-8")


def rows(text):
    """Cells of each line of the page's tables, without their heads."""
    lines = [line.strip("|").split("|") for line in text.splitlines() if re.match(r"\| (?!-)", line)]
    return [[cell.strip() for cell in line] for line in lines]


def verbs(command=main, path="trimtab"):
    """Every command below the command line, by its path."""
    context = click.Context(command, info_name=path)
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            yield f"{path} {name}", below
            yield from verbs(below, f"{path} {name}")


def parse(line):
    """Give the command line's words to click, which refuses what it doesn't know; nothing is run."""
    _, *words = shlex.split(line)
    command, context = main, click.Context(main, info_name="trimtab")
    while isinstance(command, click.Group):
        command = command.get_command(context, words.pop(0))
        assert command is not None, line
    command.make_context(line, words, parent=context)


@cache
def command_text():
    context = click.Context(main, info_name="trimtab")
    listed = main.list_commands(context)
    return {n: reference.render_command(main.get_command(context, n), f"trimtab {n}").astext() for n in listed}


def test_nine_tutorial_chapters_have_duration_summary_and_exercise():
    assert [c.stem.split("-")[0] for c in CHAPTERS] == [str(k) for k in range(1, 10)]
    for chapter in CHAPTERS:
        text = chapter.read_text(encoding="utf-8")
        assert re.search(r"^\*\d\d minutes", text, re.MULTILINE), chapter
        places = [
            text.index(part) for part in ("```{code-cell}", "## What you have now", "## Exercise", "Answer</summary>")
        ]
        assert places == sorted(places), chapter


def test_every_theory_page_computes_a_figure_and_names_its_sources():
    assert len(THEORY) == 5
    for page in THEORY:
        text = page.read_text(encoding="utf-8")
        assert "plt.subplots" in text, page
        assert "$$" in text, page
        assert "\nSources: " in text, page


def shell_lines(text):
    """What pages run or show as commands of trimtab, whole lines joined where they go on."""
    for info, block in re.findall(r"^```([^\n]*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        if info and "%%bash" not in block:
            continue
        for line in block.replace("\\\n", " ").splitlines():
            for piece in re.split(r"\s(?:\|\|?|&&|>|2>)\s", line):
                words = re.sub(r"^(timeout \d+ )", "", piece.strip())
                if words.startswith("trimtab ") and "…" not in words and "--help" not in words:
                    yield words


@pytest.mark.parametrize("page", CHAPTERS, ids=lambda p: p.stem)
def test_every_tutorial_command_is_valid(page):
    lines = list(shell_lines(page.read_text(encoding="utf-8")))
    assert lines
    for line in lines:
        parse(line)


def test_every_readme_command_is_valid():
    blocks = re.findall(r"^```\n(.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("trimtab ")]
    assert len(lines) > 40
    for line in lines:
        assert "…" not in line, line
        for command in re.split(r" {3,}", line)[0].split(" && "):
            parse(command)


def test_parse_rejects_unknown_option():
    with pytest.raises(click.UsageError):
        parse("trimtab run hovercraft/forward --plott a.png")


def test_last_chapter_matches_the_boat_example():
    text, boat = (
        CHAPTERS[-1].read_text(encoding="utf-8"),
        (ROOT / "examples" / "my_boat.py").read_text(encoding="utf-8"),
    )
    replaced = re.findall(r'^    (?:"""|")(.+?)"+,\n    "', text, re.MULTILINE)
    assert len(replaced) == 2
    assert all(boat.count(piece) == 1 for piece in replaced)
    table = re.findall(r"^\| (`.+?) \|", text, re.MULTILINE)
    named = [name for cell in table for name in re.findall(r"`(\w+)`", cell)]
    assert sorted(named) == sorted(re.findall(r"^(?:class|def) (\w+)", boat, re.MULTILINE))
    paths = re.findall(r"`(?:world\.vehicle|autopilot\.law)\.(\w+)`", text)
    assert paths
    assert all(f"    {name}: Scalar = quantity(" in boat for name in paths)


@pytest.mark.parametrize("name", trimtab.HOMES)
def test_every_top_level_name_is_documented(name):
    (made,) = [s for s in front_door() if s["ids"][0] == f"trimtab-{name.lower().replace('_', '-')}"]
    said = inspect.getdoc(getattr(trimtab, name)).split("\n")[0]
    assert len(said) > 20
    assert " ".join(said.replace("`", "").split())[:30] in made.astext().replace("`", "")


@cache
def front_door():
    directive = object.__new__(reference.Names)
    directive.state = directive.state_machine = None
    notes = []
    domain = type("Domain", (), {"note_object": lambda self, *words: notes.append(words)})()
    environment = type("Environment", (), {"domains": {"py": domain}})()
    reference.Names.env = property(lambda self: environment)
    made = directive.run()
    assert len(notes) == len(trimtab.HOMES)
    return made


def test_every_option_is_in_the_command_reference():
    for path, command in verbs():
        text = command_text()[path.split()[1]]
        for parameter in command.params:
            for option in parameter.opts if isinstance(parameter, click.Option) and not parameter.hidden else ():
                assert option in text, f"{path} {option}"


def test_reference_of_parts_lists_quantities_with_units():
    cls = importlib.import_module("trimtab.vehicles.hovercraft").Hovercraft
    text = "\n".join(node.astext() for node in reference.render_fields(cls))
    assert re.search(r"mass\s+2\.6\s+kg\s+> 0\s+Total mass", text)


CLAIMS = [row for row in rows(read("claims.md")) if row[0] != "claim"]


@pytest.mark.parametrize("row", CLAIMS, ids=lambda row: row[0])
def test_command_of_each_claim_exists(row):
    command = row[2].strip("`")
    program, *words = shlex.split(command)
    if program == "trimtab":
        parse(command)
    else:
        files = [w for w in words if "/" in w]
        assert files, command
        assert all((ROOT / f).exists() for f in files), command


@pytest.mark.parametrize("row", [row for row in CLAIMS if re.search(r"\d", row[1])], ids=lambda row: row[0])
def test_figures_of_each_claim_match_the_page_it_cites(row):
    """Each figure is on the page that explains it, or in the README's table of studies."""
    page = re.search(r"\]\(([^)#]+)", row[3])[1]
    said = read(page) + (ROOT / "README.md").read_text(encoding="utf-8")
    for figure in re.findall(r"\d+(?:[ .]\d+)*(?: of \d+)?", row[1]):
        assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d]|\.\d)", said), f"{figure} is not in {page}"


def test_claims_page_covers_every_kind():
    assert len(CLAIMS) > 25
    assert read("claims.md").count("\n## ") >= 6


MESSAGES = [row[0].strip("`") for row in rows(read("troubleshooting.md")) if row[0].startswith("`")]


@cache
def sources():
    files = (ROOT / "src" / "trimtab").rglob("*.py")
    texts = [f.read_text(encoding="utf-8") for f in files]
    return "\n".join(t for t in texts if "InputError" in t or "ConnectionProblem" in t or "wrong key" in t)


@pytest.mark.parametrize("message", MESSAGES)
def test_every_explained_message_exists_in_sources(message):
    assert message in sources()


def test_more_than_40_messages_are_explained():
    assert len(MESSAGES) > 40


WORDS = {
    "Monte Carlo": "campaign/campaign.md",
    "linearize": "design/any-vehicle.md",
    "Simulink": "comparison.md",
    "Bode": "design/closed-loop.md",
    "quadrotor": "vehicles/quadrotor.md",
    "hardware in the loop": "live/vehicle.md",
    "dSPACE": "live/vehicle.md",
    "gain scheduling": "loop/references.md",
    "LQR": "design/feedback.md",
    "Kalman": "estimators/kalman.md",
    "PID": "laws/state-feedback.md",
    "MPC": "laws/receding-horizon.md",
    "Smith predictor": "loop/predictor.md",
    "system identification": "identify/identification.md",
    "neural network": "laws/neural-policy.md",
    "GPS": "sensors/gnss.md",
    "ROS": "logs/foreign-logs.md",
    "code generation": "export/export-c.md",
    "PX4": "how-to/ground-station.md",
    "drone": "vehicles/quadrotor.md",
    "submarine": "vehicles/torpedo.md",
    "observability": "theory/observability.md",
    "non-minimum phase": "theory/non-minimum-phase.md",
    "anti-windup": "laws/state-feedback.md",
    "step response": "logs/metrics.md",
}


@pytest.mark.parametrize("word", WORDS)
def test_glossary_links_field_terms_to_their_page(word):
    """The search index holds the words of every page: those of a line of the glossary, whose link is the page."""
    assert (DOCS / WORDS[word]).is_file()
    lines = read("glossary.md").splitlines()
    assert any(re.search(rf"\b{word}\b", line) and f"]({WORDS[word]}" in line for line in lines)


def test_readme_pictures_exist_and_are_small():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).stat().st_size < (1_000_000 if picture.endswith(".gif") else 200_000)
    assert "python examples/first_flight.py" in text


def test_every_page_named_in_readme_exists():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for page in re.findall(r"\]\(((?:docs/)?[\w/.-]+\.md)", text):
        assert (ROOT / page).is_file(), page

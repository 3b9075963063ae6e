"""The page of `trimtab reproduce --report`: self-contained, escaped, with the errata of the study."""

import base64
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.commands.reproduce_page import build_page, describe_environment, read_errata
from trimtab.study import StudyGroup, find_study, same, within

GROUP = StudyGroup(Path("nowhere.py"), "first-group", 'Figures & "rows" <of> chapter 1', "1", True)
NOTE = 'It "rained" & <b>poured</b>.'
ROWS = [
    within("a/1", "<script>alert(1)</script>", 2.0, 2.05, "[1] table 1 & 2", tolerance=0.1, unit="m"),
    within(
        "a/2", "width", 2.0, 3.0, "[1] table 1", tolerance=0.1, must_hold=False, note='It "rained" & <b>poured</b>.'
    ),
    same("a/3", "runs", 4, 5, "[1] table 2", basis="own"),
]
SUMMARY = {
    "sentence": "1 of 3 rows confirm",
    "verdicts": {"holds": 1, "differs": 1, "not reproduced": 1},
    "bases": {"printed": {"holds": 1, "rows": 2}, "own": {"holds": 0, "rows": 1}},
}
ERRATA = """# Errata

| where | why |
|---|---|
| eq. 1 | a \\| b <i>x</i>, see [page](other.md), [doi](https://doi.org/1) |
"""
PIXEL = b"\x89PNG drawn"


class Elements(HTMLParser):
    """What a browser would see: start tags with their attributes, closing tags in order, text."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags, self.open, self.text = [], [], []
        self.feed(page)
        assert self.open == [], "every element is closed"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "br", "hr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def page(tmp_path):
    picture = tmp_path / "fig-1.png"
    picture.write_bytes(PIXEL)
    about = {"command": "trimtab reproduce x", "system": "<none>"}
    return build_page("A <study> & more", [(GROUP, ROWS)], SUMMARY, {"first-group": [picture]}, ERRATA, about)


def test_page_contains_all_text_with_markup_escaped(page):
    found = Elements(page)
    text = " ".join(found.text)
    for words in (
        "<script>alert(1)</script>",
        'It "rained" & <b>poured</b>.',
        "A <study> & more",
        "<none>",
        "a | b <i>x</i>",
    ):
        assert words in text
    assert {"script", "b", "i", "of", "study"} & {tag for tag, _ in found.tags} == set()
    for words in ("1 of 3 rows confirm", "± 0.1", "2.05", "own", "not reproduced", "[1] table 1 & 2"):
        assert words in text


def test_page_is_self_contained(page):
    found = Elements(page)
    (picture,) = [attrs for tag, attrs in found.tags if tag == "img"]
    kind, data = picture["src"].split(",")
    assert (kind, base64.b64decode(data)) == ("data:image/png;base64", PIXEL)
    assert picture["alt"] == "fig 1"
    links = [attrs["href"] for tag, attrs in found.tags if tag == "a"]
    anchors = {attrs["id"] for _, attrs in found.tags if "id" in attrs}
    assert "https://doi.org/1" in links
    assert {link.removeprefix("#") for link in links if link.startswith("#")} <= anchors
    assert all(link.startswith(("#", "https://")) for link in links)
    assert not re.search(r"url\(|@import|<link", page)


def test_rows_have_the_class_of_their_verdict(page):
    kinds = [attrs.get("class") for tag, attrs in Elements(page).tags if tag == "tr"]
    assert [k for k in kinds if k] == ["holds", "not-reproduced", "differs"]


def test_page_contains_errata_of_its_study(tmp_path):
    assert read_errata(find_study("hypersonic2022")).startswith("# Errata of the hypersonic vehicle")
    assert "hypersonic" not in read_errata(find_study("hovercraft2006")).splitlines()[0]
    own = tmp_path / "somebody1999"
    own.mkdir()
    (own / "errata.md").write_text("# Mine\n")
    assert read_errata(own) == "# Mine\n"


def test_environment_lists_versions_without_local_paths():
    found = describe_environment(["reproduce", "hypersonic2022", "--report", "my page"], "2026-01-01 00:00 UTC", 12.3)
    assert found["command"] == "trimtab reproduce hypersonic2022 --report 'my page'"
    assert {"jax", "numpy", "scipy", "Python", "system"} <= set(found)
    assert not any(str(Path.home()) in value or str(Path.cwd()) in value for value in found.values())


@pytest.mark.thorough
def test_group_of_real_study_produces_small_page(tmp_path):
    words = ["reproduce", "hypersonic2022", "--only", "printed-matrices", "--report", str(tmp_path / "new"), "--json"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (file,) = json.loads(done.stdout)["files"]
    text = Path(file).read_text(encoding="utf-8")
    assert Path(file) == tmp_path / "new" / "index.html"
    rows = json.loads(done.stdout)["rows"]
    lines = sum(tag == "tr" for tag, _ in Elements(text).tags)
    assert lines > len(rows) > 40
    assert "Errata of the hypersonic vehicle" in text
    assert str(tmp_path) not in text
    assert len(text) < 200_000


def test_rejects_unwritable_report_before_study_runs():
    done = CliRunner().invoke(main, ["reproduce", "hypersonic2022", "--report", "/dev/null/x"])
    assert done.exit_code == 2
    assert "--report" in done.stderr

"""Links of the built pages and of the README are valid; the search finds error messages."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from sphinx.search.en import SearchEnglish

ROOT = Path(__file__).parents[2]


class Page(HTMLParser):
    """Links and ids of a page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.ids = [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids |= {given[key] for key in ("id", "name") if given.get(key)}
        self.links += [given[key] for key in ("href", "src") if given.get(key)]


def dead_links(folder):
    """(page, link) of what leads to no file of the folder, or to no place of a page."""
    pages = {path: Page(path.read_text("utf-8")) for path in sorted(folder.rglob("*.html"))}
    dead, count = [], 0
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            count += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            if not target.is_file() or (place and target in pages and place not in pages[target].ids):
                dead.append((path.relative_to(folder).as_posix(), link))
    return dead, count


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    made = tmp_path_factory.mktemp("site").resolve()
    words = [
        "-q",
        "-D",
        "nb_execution_mode=off",
        "-d",
        str(made / "doctrees"),
        "-b",
        "html",
        "docs",
        str(made / "html"),
    ]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return made / "html"


@pytest.mark.thorough
@pytest.mark.timeout(1200)
def test_built_pages_have_no_dead_links(site):
    dead, count = dead_links(site)
    assert count > 10_000
    assert dead == []


SEARCHED = {
    "unknown setting": "reference/messages",
    "a finite number of runs cannot prove a probability of": "reference/messages",
    "other users can read or change it": "reference/messages",
    "anyone on the network path to could read the token and fly the craft": "reference/messages",
    "is not HOST:PORT with a port from 1 to 65535": "reference/messages",
    "does not settle": "reference/messages",
    "the solver Clarabel is not installed": "reference/messages",
    "the ticks do not rise, or are not whole numbers": "reference/messages",
    "neither sector was ever used": "reference/messages",
    "JAX finds no GPU, only": "reference/messages",
}


@pytest.mark.thorough
@pytest.mark.parametrize("words", SEARCHED)
def test_search_finds_message_by_its_words(words, site):
    """Like the search: a page is found if its text or a title has the stem of every word, except stop words."""
    index = json.loads((site / "searchindex.js").read_text("utf-8").removeprefix("Search.setIndex(").removesuffix(")"))
    language = SearchEnglish({})
    page = index["docnames"].index(SEARCHED[words])
    stems = {language.stem(word) for word in re.findall(r"\w+", words.lower()) if language.word_filter(word)}
    for stem in filter(language.word_filter, stems):
        found = [index[where].get(stem, []) for where in ("terms", "titleterms")]
        assert any(page in (pages if isinstance(pages, list) else [pages]) for pages in found), stem


def test_detects_dead_links_and_dead_anchors(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="#here"><a href="b.html#there"><a href="#gone"><img src="c.png">'
    )
    (tmp_path / "b.html").write_text('<h1 id="there"><a href="a.html#here"><a href="https://example.org/none">')
    assert dead_links(tmp_path) == ([("a.html", "#gone"), ("a.html", "c.png")], 5)


def test_every_relative_link_of_readme_exists():
    text = re.sub(r"^```.*?^```$", "", (ROOT / "README.md").read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    links = [urlsplit(link) for link in re.findall(r"\]\(([^)\s]+)\)", text)]
    paths = [link.path for link in links if not link.scheme and link.path]
    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []

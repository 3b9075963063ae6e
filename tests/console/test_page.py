"""The files of the page: no external requests, a strict content policy, and small size."""

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

import trimtab

PAGE = Path(trimtab.__file__).parent / "console" / "page"
FILES = sorted(path for path in PAGE.rglob("*") if path.is_file())
OWN = [path for path in FILES if "vendor" not in path.relative_to(PAGE).parts]
MODULES = [path for path in OWN if path.suffix == ".js"]
IMPORT = re.compile(r"""(?:\bfrom|\bimport)\s*\(?\s*["']([^"']+)["']""")
ADDRESS = re.compile(r"(?:https?|wss?)://", re.IGNORECASE)
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
STYLE_ADDRESS = re.compile(r"""url\(\s*["']?([^"')]+)|@import\s+["']([^"']+)""")


class _Elements(HTMLParser):
    """The elements of a page: tag, attributes, and the text right in them."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        if self.found and data.strip():
            self.texts.append((self.found[-1][0], data))


def _elements() -> _Elements:
    parser = _Elements()
    parser.feed((PAGE / "index.html").read_text())
    return parser


def _lines(path: Path) -> int:
    return len(path.read_text().splitlines())


def _name(path: Any) -> str:
    return str(path.relative_to(PAGE))


def test_page_files_are_packaged():
    names = {_name(path) for path in FILES}
    assert {"index.html", "console.css", "main.js", "stop.js", "vendor/README", "vendor/LICENSE-uPlot"} <= names


@pytest.mark.parametrize("path", [path for path in FILES if path.suffix != ".png"], ids=_name)
def test_page_contains_no_external_address(path: Path):
    if path.name.startswith("LICENSE"):
        return
    text = path.read_text()
    if path not in OWN:
        text = COMMENT.sub("", text)
    assert ADDRESS.findall(text) == []


def test_no_inline_script_or_style():
    elements = _elements()
    for tag, attributes in elements.found:
        assert tag != "style"
        assert "style" not in attributes, tag
        assert [name for name in attributes if name.startswith("on")] == [], tag
        if tag == "script":
            assert attributes.get("src"), "a script without src"
    assert [text for tag, text in elements.texts if tag == "script"] == []


@pytest.mark.parametrize("path", MODULES, ids=_name)
def test_modules_write_no_html(path: Path):
    """Text from the server is never inserted as markup or executed."""
    text = path.read_text()
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "new Function", '"style"'):
        assert word not in text


def test_stop_script_loads_first_without_imports():
    scripts = [attributes["src"] for tag, attributes in _elements().found if tag == "script"]
    assert scripts[0] == "stop.js"
    assert IMPORT.findall((PAGE / "stop.js").read_text()) == []


def test_page_files_stay_below_line_limits():
    assert _lines(PAGE / "console.css") < 300
    assert {_name(path): _lines(path) for path in MODULES if _lines(path) > 400} == {}


def test_every_referenced_file_exists():
    wanted = {
        str(attributes[name]) for _, attributes in _elements().found for name in ("src", "href") if name in attributes
    }
    assert len(wanted) >= 5
    for path in MODULES:
        imported = IMPORT.findall(path.read_text())
        assert all(name.startswith("./") for name in imported), path.name
        wanted |= set(imported)
    for path in (path for path in FILES if path.suffix == ".css"):
        wanted |= {a or b for a, b in STYLE_ADDRESS.findall(path.read_text())}
    assert [name for name in sorted(wanted) if not (PAGE / name).is_file()] == []


def test_every_module_is_used():
    used = {name.removeprefix("./") for path in MODULES for name in IMPORT.findall(path.read_text())}
    used |= {str(attributes.get("src")) for tag, attributes in _elements().found if tag == "script"}
    assert sorted({path.name for path in MODULES} - used) == []


def test_every_element_id_used_by_scripts_exists():
    """An id used by a module is defined in the page or in an element that a module builds."""
    ids = {str(attributes["id"]) for _, attributes in _elements().found if "id" in attributes}
    for path in MODULES:
        asked = set(re.findall(r"""(?:getElementById|byId)\("([^"]+)"\)""", path.read_text()))
        assert asked <= ids, path.name

"""Studies and groups are found from the folders."""

import pytest

from trimtab import study
from trimtab.core.errors import InputError

NAME = "hovercraft2006"


def test_lists_studies_and_groups_that_define_rows():
    assert NAME in study.find_studies()
    found = study.list_groups(NAME)
    folder = study.CLONE / NAME
    files = {f.stem.replace("_", "-") for f in folder.glob("*.py") if "\ndef rows(" in f.read_text(encoding="utf-8")}
    assert {g.name for g in found} == files >= {"control-laws", "inertia", "simulated-autopilot"}
    assert all(g.title and g.section for g in found)


def test_groups_are_in_the_order_of_the_publication(tmp_path, monkeypatch):
    sections = {"early": "2.10", "late": "10.1", "first": "2.2", "equations": "eqs. 3-4", "unnumbered": "simulation"}
    for name, section in sections.items():
        (tmp_path / "s").mkdir(exist_ok=True)
        (tmp_path / "s" / f"{name}.py").write_text(f'"""T."""\nSECTION = "{section}"\ndef rows(): ...\n')
    (tmp_path / "s" / "__init__.py").write_text('"""A study."""\n')
    (tmp_path / "s" / "errata.py").write_text('"""No group."""\n')
    monkeypatch.setattr(study, "CLONE", tmp_path)
    found = study.list_groups("s")
    assert [g.name for g in found] == ["first", "early", "equations", "late", "unnumbered"]
    assert [g.place for g in found[1:3]] == ["section 2.10", "eqs. 3-4"]
    assert [g.name for g in study.list_groups("s", ["late"])] == ["late"]


def test_unknown_study_or_group_name_lists_choices():
    with pytest.raises(InputError, match=r"no such study.*\nChoices: .*\nFix: trimtab reproduce hovercraft2006"):
        study.list_groups("hovercraft")
    with pytest.raises(InputError, match=r"no group 'inertial'.*\nChoices: .*\nFix: only=\[.inertia"):
        study.list_groups(NAME, ["inertia", "inertial"])


def test_user_study_is_loaded_from_its_folder(tmp_path):
    folder = tmp_path / "somebody2001"
    folder.mkdir()
    with pytest.raises(InputError, match=r"no __init__\.py"):
        study.find_study(str(folder))
    (folder / "__init__.py").write_text('"""Somebody, 2001."""\n')
    (folder / "sizes.py").write_text(
        '"""Sizes."""\nfrom trimtab.study import within\n\n\ndef rows():\n'
        '    yield within("length", "length", 2.0, 2.0, "[1] table 1", tolerance=0.1)\n'
    )
    (group,) = study.list_groups(str(folder))
    assert [row.verdict for row in group.rows()] == ["holds"]


def test_missing_clone_error_names_the_source_repository(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "CLONE", tmp_path / "nowhere")
    monkeypatch.chdir(tmp_path)
    assert study.find_studies() == {}
    with pytest.raises(InputError, match="source repository"):
        study.find_study(NAME)

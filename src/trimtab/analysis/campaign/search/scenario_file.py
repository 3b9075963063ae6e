"""Scenario files that a search writes: a scenario with the exact parameter values that the search found."""

import os
import pprint
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.analysis.campaign.workers.prepare import CampaignPlan
from trimtab.core.errors import InputError
from trimtab.logs.mcap import replace_file
from trimtab.scenarios.build import LINKS
from trimtab.scenarios.catalogue import TOML

BODY = '''
import numpy as np

{varying}from trimtab.core.record import {names}
from trimtab.loop.scenario import Scenario
from trimtab.scenarios.build import build

SETTINGS = {settings}
WITHOUT = {without}
FAULTS = {faults}
VALUES = {values}
{more}

def scenario() -> Scenario:
    """The scenario with these values."""
    made = {made}
    for path, (value, dtype) in VALUES.items():
        made = with_leaf(made, path, lambda old, declared, value=value, dtype=dtype: np.array(value, dtype)[()])
    return {result}
'''


def write_scenario(
    file: Path, plan: CampaignPlan, values: Mapping[str, Any], about: str, words: tuple[int, ...] = ()
) -> None:
    """Write a scenario file atomically.

    Args:
        file: path of the new file. The file refers to a user's own scenario file by a relative path.
        plan: plan with the scenario, its settings, its faults and the effects left out.
        values: path -> number or array.
        about: lines of the file's docstring.
        words: random keys that select the noise of run 0. If empty, the noise of run 0 is that of a campaign.
    """
    own, _, function = plan.scenario.rpartition(":")
    head, name = '"""' + about.replace('"""', "'''").strip() + '\n"""\n', repr(plan.scenario)
    if own.endswith(".py"):
        name = f'{_path_expression(own, file.parent)} + ":{function}"'
    elif plan.scenario.endswith(TOML):
        name = _path_expression(plan.scenario, file.parent)
    recorded = {link: _path_expression(text, file.parent) for link, text in plan.settings if link in LINKS}
    settings = _format_literal({p: text for p, text in plan.settings if p not in recorded})
    if recorded:
        settings += f" | {{{', '.join(f'{link!r}: {path}' for link, path in recorded.items())}}}"
    if "Path(" in name + settings:
        head += "\nfrom pathlib import Path\n"
    typed = {p: (np.asarray(v).tolist(), str(np.asarray(v).dtype)) for p, v in values.items()}
    calibration = ""
    if plan.calibration:
        head += "\nfrom trimtab.loop.calibration import parse_calibration\n"
        calibration = f", parse_calibration('calibration', {_format_literal(plan.calibration)})"
    made, more = f"build({name}, SETTINGS, WITHOUT, FAULTS{calibration})", ""
    if plan.inputs:
        made, more = f"with_pieces({made}, INPUTS)", f"INPUTS = {_format_literal(plan.inputs)}\n"
    if words:
        more += f"WORDS = {_format_literal(words)}\n"
    body = BODY.format(
        made=made,
        settings=settings,
        without=_format_literal(plan.without),
        faults=_format_literal(plan.faults),
        values=_format_literal(typed),
        more=more,
        varying="from trimtab.analysis.campaign.sampling.varying import with_pieces\n" if plan.inputs else "",
        names="replace, with_leaf" if words else "with_leaf",
        result="replace(made, words=WORDS)" if words else "made",
    )
    file.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(file) as stream:
        stream.write((head + body).encode())


def check_file(part: str, file: Path) -> None:
    """Raise InputError if the file's name is not a Python identifier with the ending .py, or if it is a folder."""
    if file.suffix != ".py" or not file.stem.isidentifier():
        fix = f"{part} {file.with_name('found.py')}"
        raise InputError(part, f"{file.name!r} is not the name of a Python file", fix=fix)
    if file.is_dir():
        raise InputError(part, f"{str(file)!r} is a folder", fix=f"{part} {file / 'found.py'}")


def _path_expression(file: str, folder: Path) -> str:
    """Return a Python expression for a file's path. folder: folder of the file that will contain the expression."""
    return f"str(Path(__file__).parent / {Path(os.path.relpath(file, folder)).as_posix()!r})"


def _format_literal(value: Any) -> str:
    return pprint.pformat(value, width=110, sort_dicts=True)

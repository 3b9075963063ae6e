"""Functions of other people's libraries, compiled and compared with jax.jit; those that are refused, exactly."""

import importlib
import importlib.util
import warnings
from types import ModuleType

import pytest

import trimtab
from compiler.foreign.agreement import CLOSE, draw_runs, measure_agreement, measure_sensitivity
from compiler.foreign.case import Case
from trimtab.core.errors import InputError

LIBRARIES = {
    "jaxlie": ("jaxlie",),
    "brax": ("brax", "mujoco.mjx"),
    "equinox": ("equinox",),
    "jaxopt": ("jaxopt",),
    "blackjax": ("blackjax",),
    "diffrax": ("diffrax",),
    "optimistix": ("optimistix", "lineax", "optax"),
    "jax_scipy": (),
    "own": ("interpax",),
}
"""Files of cases, and the packages that they need."""
QUICK = 2
"""Cases of each library that are tried each time."""


def load_cases(library: str) -> list[Case]:
    """The list of a library; skips the test where it is not installed."""
    for package in LIBRARIES[library]:
        pytest.importorskip(package.split(".")[0], reason="pip install 'trimtab[foreign]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # other people's, when imported
        module: ModuleType = importlib.import_module(f"compiler.foreign.{library}_cases")
    return module.CASES


def differences(cases: list[Case]) -> list[str]:
    """A line for each case that is not what it should be."""
    lines: list[str] = []
    for case in cases:
        try:
            found = measure_agreement(case)
        except InputError as refusal:
            lines.append(f"{case.name}: refused: {refusal}")
            continue
        allowed = CLOSE if not case.sensitive else max(CLOSE, 10 * measure_sensitivity(case))
        if not found.apart <= allowed:
            lines.append(f"{case.name}: {found.apart:.1e} of its scale from jax.jit, {allowed:.1e} allowed")
        if not found.same_in_lanes:
            lines.append(f"{case.name}: other bits in lanes")
    return lines


@pytest.mark.thorough
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.filterwarnings("ignore")
def test_first_functions_agree_with_jax(library: str) -> None:
    assert differences([c for c in load_cases(library) if not c.refused][:QUICK]) == []


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.filterwarnings("ignore")
def test_all_functions_agree_with_jax(library: str) -> None:
    assert differences([c for c in load_cases(library) if not c.refused][QUICK:]) == []


@pytest.mark.filterwarnings("ignore")
def test_rejected_primitives_report_place_and_fix() -> None:
    refused = [c for c in load_cases("jax_scipy") if c.refused in ("eig", "fft")]
    assert len(refused) == 3
    check_refusals(refused)


@pytest.mark.thorough
@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.filterwarnings("ignore")
def test_rejected_functions_report_place_and_fix(library: str) -> None:
    cases = load_cases(library)
    assert len({c.name for c in cases}) == len(cases)
    check_refusals([c for c in cases if c.refused])


def check_refusals(cases: list[Case]) -> None:
    """Check that each case is refused with its reason, a line of a file, and a fix."""
    for case in cases:
        with pytest.raises(InputError) as caught:
            trimtab.compile(case.function, *draw_runs(case)[0])
        assert case.refused in str(caught.value)
        assert ".py:" in str(caught.value)
        assert caught.value.fix


@pytest.mark.thorough
def test_at_least_77_cases_of_which_65_compile() -> None:
    installed = [n for n, needs in LIBRARIES.items() if all(importlib.util.find_spec(p.split(".")[0]) for p in needs)]
    if len(installed) < len(LIBRARIES):
        pytest.skip("pip install 'trimtab[foreign]'")
    cases = [c for library in LIBRARIES for c in load_cases(library)]
    assert len(cases) >= 77
    assert sum(not c.refused and not c.sensitive for c in cases) >= 65

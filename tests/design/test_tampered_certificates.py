"""False certificates: `trimtab design --check` rejects every one, and accepts unmodified files.

Each tampered file is one of the shipped vehicle with one thing changed, the digest made anew where the file can still
be read. What must be in the answer stands beside each change.
"""

import contextlib
import itertools
import json

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.core.errors import InputError
from trimtab.design.certificate_file import certificate_digest, certificate_json, parse_certificate
from trimtab.design.lqr import kalman_bucy, lqr
from trimtab.scenarios.hypersonic import _design as hypersonic

OF = " is that of hypersonic"
FIELDS = {
    "A": "A" + OF,
    "B": "B" + OF,
    "K": "K = -R_e^-1 B'P",
    "P": "left side of (14) = Q_e - Q",
    "Qe": "Q_e" + OF,
    "Re": "R_e" + OF,
    "Q": "Q" + OF,
    "observer.A": "A_eta" + OF,
    "observer.C": "C" + OF,
    "observer.Q": "Q_eta" + OF,
    "observer.R": "R" + OF,
    "observer.P": "Riccati equation of P_eta",
    "observer.L": "L = P_eta C'R^-1",
}
"""Every matrix -> the line that must see a change of it."""


def part(content, path):
    for name in path.split("."):
        content = content[name]
    return content


def put(content, path, value):
    *inner, last = path.split(".")
    for name in inner:
        content = content[name]
    content[last] = value.tolist() if isinstance(value, np.ndarray) else value


def matrix_changes():
    """Name -> (matrix -> changed matrix): sizes, signs, places and NaN."""

    def at_largest(change):
        def changed(M):
            M = M.copy()
            i = np.unravel_index(np.abs(M).argmax(), M.shape)
            M[i] = change(M[i])
            return M

        return changed

    return {
        "one entry by 1e-6": at_largest(lambda v: v * (1 + 1e-6)),
        "one sign": at_largest(lambda v: -v),
        "all signs": lambda M: -M,
        "huge": at_largest(lambda v: 1e40),
        "tiny": at_largest(lambda v: 1e-40),
        "reversed": lambda M: M[::-1, ::-1] if M.size > 1 else M + 1e-3,
        "not a number": at_largest(lambda v: float("nan")),
    }


def change_matrix(path, change):
    return lambda c: put(c, path, change(np.array(part(c, path), float)))


def rescale(c, size):
    """Another unit for a state, through all matrices: a consistent file of the same vehicle, but in other units."""
    d = np.ones(len(c["states"]))
    d[list(size)] = list(size.values())
    for name, power in (("A", 0), ("B", -1), ("K", 1), ("P", 2), ("Qe", 2), ("Q", 2)):
        M = np.array(c[name])
        left = {0: 1 / d, -1: 1 / d, 1: np.ones(len(M)), 2: d}[power][:, None]
        right = np.ones(M.shape[1]) if power == -1 else d
        c[name] = (M * left * right).tolist()
    c["scale"] = (np.array(c["scale"]) / d).tolist()


def other_plant(c, **settings):
    """The matrices of another system under this one's name and settings."""
    text = certificate_json(hypersonic.certificate(mode_error=0.0, **settings))
    other = json.loads(text)
    for name in ("A", "B", "K", "P", "Qe", "Re", "Q", "scale", "poles", "observer", "recorded"):
        c[name] = other[name]


def heavier_plant(c, **scale):
    """A consistent certificate of a plant with 30 % less of some entries, under this name, and sizes to hide it."""
    system = hypersonic.certified_system()
    A = system.A.copy()
    A[4] *= 0.7
    gain = lqr(A, system.B, system.Q, system.Re, scale=system.scale)
    c["A"], c["K"], c["P"] = A.tolist(), gain.K.tolist(), ((gain.P + gain.P.T) / 2).tolist()
    c["poles"] = [[p.real, p.imag] for p in gain.poles]
    for i, size in scale.items():
        c["scale"][int(i[1:])] = size


def other_observer(c, A=None, C=None, R=None):
    """A consistent filter, of another system."""
    o = c["observer"]
    A, C, R = (np.array(o[n] if M is None else M, float) for n, M in (("A", A), ("C", C), ("R", R)))
    kalman = kalman_bucy(A, C, np.array(o["Q"]), R)
    o |= {"A": A.tolist(), "C": C.tolist(), "R": R.tolist(), "L": kalman.L.tolist()}
    o |= {"P": ((kalman.P + kalman.P.T) / 2).tolist(), "poles": [[p.real, p.imag] for p in kalman.poles]}


def flip_observer(c):
    for name in ("C", "L"):
        c["observer"][name] = (-np.array(c["observer"][name])).tolist()


def half_recorded(name):
    return lambda c: c["recorded"].__setitem__(name, 0.5 * c["recorded"][name] + 1e-6)


def swap_states(c):
    c["states"][0], c["states"][2] = c["states"][2], c["states"][0]


CASES = {
    f"{path}, {name}": (change_matrix(path, change), FIELDS[path] if "number" not in name else "not a number")
    for (path, (name, change)) in itertools.product(FIELDS, matrix_changes().items())
    if not (name == "reversed" and path in ("Re",))
}
CASES |= {
    f"scale[{i}] = {size:g}": (lambda c, i=i, size=size: c["scale"].__setitem__(i, size), "scale")
    for i, size in ((0, 1e-20), (0, 1e20), (3, 1e-20), (4, 1e20), (6, 1e-20), (8, 0.5), (2, 20.0001))
}
CASES |= {
    "units of h": (lambda c: rescale(c, {0: 0.3048}), "A" + OF),
    "units of the modes": (lambda c: rescale(c, {5: 1e-3, 6: 1e-3}), "A" + OF),
    "another plant, sizes kept": (heavier_plant, "A" + OF),
    "another plant, size of h tiny": (lambda c: heavier_plant(c, _0=1e-20), "A" + OF),
    "another plant, size of q tiny": (lambda c: heavier_plant(c, _4=1e-20), "A" + OF),
    "another plant, size of q huge": (lambda c: heavier_plant(c, _4=1e20), "A" + OF),
    "another altitude's plant": (lambda c: other_plant(c, h_ft=86e3), "A" + OF),
    "another speed's plant": (lambda c: other_plant(c, V_ft_per_s=7710.0), "A" + OF),
    "another reading's plant": (lambda c: other_plant(c, kmode="author"), "A" + OF),
    "another filter's setting": (lambda c: other_plant(c, filter="printed"), "R" + OF),
    "another uncertainty's numbers": (lambda c: other_plant(c, uncertainty=0.5), "kappa_G, as recorded"),
    "observer with C and L turned": (flip_observer, "C" + OF),
    "observer of integrators": (lambda c: other_observer(c, np.eye(4, k=1), np.eye(1, 4)), "A_eta" + OF),
    "observer of detuned modes": (lambda c: other_observer(c, 1.1 * np.array(c["observer"]["A"])), "A_eta" + OF),
    "observer of another sensor": (lambda c: other_observer(c, C=[[1.0, 0.0, 1.0, 0.0]]), "C" + OF),
    "observer of a quieter sensor": (lambda c: other_observer(c, R=[[5e-8]]), "R" + OF),
    "observer left out": (lambda c: c.update(observer=None), "estimated states"),
    "observer of fewer states": (lambda c: c["observer"]["estimated"].pop(), "observer.A"),
    "observer of the rigid states": (
        lambda c: c["observer"].update(estimated=["h", "h'", "V", "alpha"]),
        "estimated states",
    ),
    "estimated states swapped": (lambda c: c["observer"]["estimated"].reverse(), "estimated states"),
    "states swapped": (swap_states, "states are those"),
    "inputs swapped": (lambda c: c["inputs"].reverse(), "inputs are those"),
    "least weight edited": (lambda c: c["observer"].update(least_weight=1.0), "least weight lambda*"),
    "weight below the least": (lambda c: c["observer"].update(weight=200.0), "(15)"),
    "weight negative": (lambda c: c["observer"].update(weight=-1.0), "(15)"),
    "poles moved left": (lambda c: c["poles"][0].__setitem__(0, -5.0), "poles of A + B K"),
    "duplicate pole": (lambda c: c["poles"].__setitem__(0, c["poles"][-1]), "poles of A + B K"),
    "missing pole": (lambda c: c["poles"].pop(), "poles"),
    "poles of the filter moved": (lambda c: c["observer"]["poles"][0].__setitem__(0, -9.0), "poles of A_eta"),
    "kappa_G edited": (half_recorded("kappa_G"), "kappa_G, as recorded"),
    "rho0 edited": (half_recorded("rho0 (ft/s^2)"), "rho0 (ft/s^2), as recorded"),
    "rho1 edited": (half_recorded("rho1 (ft/s^2)"), "rho1 (ft/s^2), as recorded"),
    "determinant edited": (half_recorded("least |det dv/du|"), "least |det dv/du|, as recorded"),
    "kappa_G left out": (lambda c: c["recorded"].pop("kappa_G"), "kappa_G, as recorded"),
    "every number left out": (lambda c: c.update(recorded={}), "rho1 (ft/s^2), as recorded"),
    "extra recorded number": (lambda c: c["recorded"].update(phase_margin=60.0), "no other number recorded"),
    "a limit in the file": (
        lambda c: c["recorded"].update(kappa_G={"value": 1.2, "low": 0.0, "high": 2.0, "how": "by hand"}),
        "recorded.kappa_G",
    ),
    "conditions in the file": (lambda c: c.update(conditions=[]), "unknown key"),
    "holds in the file": (lambda c: c.update(holds=True), "unknown key"),
    "a wider scope": (lambda c: c["scope"].pop(), "scope"),
    "no scope": (lambda c: c.pop("scope"), "lacks 'scope'"),
    "another name": (lambda c: c.update(system="hovercraft"), "not in the package"),
    "a name with a path": (lambda c: c.update(system="../hypersonic"), "not in the package"),
    "another altitude": (lambda c: c["about"].update(h_ft=85001.0), "A" + OF),
    "altitude out of range": (lambda c: c["about"].update(h_ft=300e3), "h_ft"),
    "no altitude": (lambda c: c["about"].pop("h_ft"), "lacks the key about.h_ft"),
    "an altitude in words": (lambda c: c["about"].update(h_ft="high"), "must be a finite number, got 'high'"),
    "another trim": (lambda c: c["about"].update(alpha_rad=0.02644), "settings and point"),
    "extra setting": (lambda c: c["about"].update(note="certified by nobody"), "settings and point"),
    "another filter by name": (lambda c: c["about"].update(filter="accurate"), "Q_eta" + OF),
    "no filter by name": (lambda c: c["about"].update(filter="none"), "estimated states"),
    "integral action by name": (lambda c: c["about"].update(integral="true"), "states are those"),
    "another method by name": (lambda c: c["about"].update(method="lmi"), "method" + OF),
    "a filter that its modes' errors defeat": (
        lambda c: other_plant(c, filter="accurate") or c["about"].update(filter="accurate", mode_error=0.01),
        "every plant of the modes' box decays",
    ),
    "modes' errors beyond what holds": (
        lambda c: c["about"].update(mode_error=0.15),
        "every plant of the modes' box decays",
    ),
    "zero uncertainty": (lambda c: c["about"].update(uncertainty=0.0), "kappa_G, as recorded"),
    "the other method": (lambda c: c.update(method="lmi", Q=None), "method" + OF),
    "no version": (lambda c: c.pop("version"), "lacks 'version'"),
    "previous format": (lambda c: c.update(format="trimtab certificate 1"), "writes a new one"),
    "future format": (lambda c: c.update(format="trimtab certificate 3"), "is not a certificate"),
    "no digest": (lambda c: c.pop("digest"), "lacks 'digest'"),
} | {f"no {key}": (lambda c, key=key: c.pop(key), f"lacks '{key}'") for key in ("A", "K", "P", "Qe", "scale", "about")}
TEXTS = {
    "truncated": (lambda text: text[: len(text) // 2], "is not valid JSON"),
    "truncated by one": (lambda text: text.rstrip()[:-1], "is not valid JSON"),
    "empty": (lambda text: "", "is not valid JSON"),
    "duplicate key": (lambda text: text.replace('"method":', '"method": "lmi",\n "method":', 1), "twice"),
    "duplicate gain": (lambda text: text.replace(' "K":', ' "K": [],\n "K":', 1), "'K' appears twice"),
    "NaN entry": (lambda text: text.replace("[0.0,", "[NaN,", 1), "is not a number"),
    "infinite entry": (lambda text: text.replace("[0.0,", "[Infinity,", 1), "is not a number"),
    "a number in quotes": (lambda text: text.replace("[0.0,", '["0.0",', 1), "must be numbers of shape"),
    "boolean entry": (lambda text: text.replace("[0.0,", "[false,", 1), "must be numbers of shape"),
    "wrong digest": (lambda text: text.replace('"digest": "', '"digest": "0', 1), "since it was written"),
    "changed digit with the old digest": (
        lambda text: text.replace("85000.0", "85000.00000000001", 1),
        "since it was written",
    ),
}


def check(text, folder):
    file = folder / "gain.json"
    file.write_text(text, encoding="utf-8")
    return CliRunner().invoke(main, ["design", "--check", str(file), "--json"])


def failing_names(answer):
    try:
        return [c["name"] for c in json.loads(answer.stdout)["conditions"] if not c["holds"]]
    except ValueError:
        return []


@pytest.fixture(scope="module")
def text():
    return certificate_json(hypersonic.certificate(mode_error=0.0))  # one box of modes: quick


def test_at_least_100_tampered_cases_exist():
    assert len(CASES) + len(TEXTS) >= 100


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES)
def test_rejects_tampered_certificate(text, case, tmp_path):
    change, words = CASES[case]
    content = json.loads(text)
    change(content)
    with contextlib.suppress(InputError):  # the digest is no defence: whoever changes a file can make it anew
        content["digest"] = certificate_digest(parse_certificate(json.dumps(content), "x")[0])
    answer = check(json.dumps(content), tmp_path)
    assert answer.exit_code in (1, 2), answer.output
    assert isinstance(answer.exception, SystemExit)
    if answer.exit_code == 1:
        assert any(words in name for name in failing_names(answer)), failing_names(answer)
        assert "file unchanged since it was written" not in failing_names(answer)
    else:
        assert words in answer.output.replace("\n", " ")


@pytest.mark.thorough
@pytest.mark.parametrize("case", TEXTS)
def test_rejects_tampered_text(text, case, tmp_path):
    change, words = TEXTS[case]
    assert change(text) != text
    answer = check(change(text), tmp_path)
    assert answer.exit_code in (1, 2), answer.output
    assert words in (" ".join(failing_names(answer)) if answer.exit_code == 1 else answer.output.replace("\n", " "))


POINTS = ((85e3, 7702.0808), (80e3, 7000.0), (95e3, 9000.0), (88e3, 8200.0))
HONEST = [
    {"h_ft": h, "V_ft_per_s": V, "filter": filter, "uncertainty": uncertainty, "mode_error": error}
    for (h, V), (filter, uncertainty, error) in itertools.product(
        POINTS, (("tuned", 1.0, 0.03), ("accurate", 0.5, 0.0), ("printed", 0.0, 0.0), ("none", 2.0, 0.0))
    )
]
HONEST += [
    {"method": "lmi"},
    {"method": "lmi", "filter": "none", "h_ft": 88e3, "V_ft_per_s": 8200.0},
    {"integral": "true"},
    {"integral": "true", "filter": "accurate", "h_ft": 80e3, "V_ft_per_s": 7000.0, "mode_error": 0.0},
    {"kmode": "paper"},
    {"kmode": "author", "filter": "accurate", "mode_error": 0.0},
]


@pytest.mark.thorough
@pytest.mark.parametrize("settings", HONEST, ids=lambda s: " ".join(map(str, s.values())))
def test_accepts_unmodified_certificate(settings, tmp_path):
    answer = check(certificate_json(hypersonic.certificate(**settings)), tmp_path)
    assert answer.exit_code == 0, failing_names(answer) or answer.output
    assert json.loads(answer.stdout)["holds"]

"""Certificates: proved, kept, and broken by every change that matters."""

import json

import numpy as np
import pytest
from design.systems import BALL_AND_BEAM

from trimtab.core.errors import InputError
from trimtab.design.certificate import (
    RecordedNumber,
    build_certificate,
    certificate_digest,
    certificate_json,
    parse_certificate,
    read_certificate,
)
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.lmi import lmi_gain
from trimtab.design.lqr import kalman_bucy, lqr

A, B = BALL_AND_BEAM
QE, RE = np.diag([4.0, 0.1, 1.0, 0.1]), np.array([[0.01]])
STATES = ("r", "r'", "theta", "theta'")
FILTER = (A[2:, 2:], np.array([[1.0, 0.0]]), np.diag([0.1, 0.3]), np.array([[0.02]]))


def made(method="lqr", observer=True):
    gain = lqr(A, B, 1.01 * QE, RE) if method == "lqr" else lmi_gain(A, B, QE, RE)
    return build_certificate(
        "ball and beam",
        (A, B),
        (gain.K, gain.P),
        (QE, RE),
        states=STATES,
        inputs=("w",),
        method=method,
        Q=1.01 * QE if method == "lqr" else None,
        observer=(STATES[2:], *FILTER, kalman_bucy(*FILTER)) if observer else None,
        recorded={"kappa": RecordedNumber(0.3, 0.0, 1.0, "by hand")},
        about={"beam_m": 1.0},
    )


@pytest.fixture(scope="module")
def certificate():
    return made()


def failing(certificate):
    return {c.name: c for c in prove_certificate(certificate).conditions if not c.holds}


@pytest.mark.parametrize("method", ["lqr", "lmi"])
@pytest.mark.parametrize("observer", [True, False])
def test_a_good_one_is_proved(method, observer):
    found = prove_certificate(made(method, observer))
    assert found.holds, [c for c in found.conditions if not c.holds]
    names = [c.name for c in found.conditions]
    assert ("P_eta > 0" in names) == observer
    assert ("K = -R_e^-1 B'P" in names) == (method == "lqr")
    inequality = found.conditions[names.index("(14)")]
    assert inequality.how.startswith("exact")
    if method == "lqr":
        assert inequality.number == pytest.approx(0.0099, rel=1e-6)  # 0.99 of Q - Q_e


def test_margins_are_below_the_true_ones(certificate):
    """P in units of its diagonal, by an eigenvalue."""
    d = 1 / np.sqrt(np.diag(certificate.P))
    number = next(c.number for c in prove_certificate(certificate).conditions if c.name == "P > 0")
    assert 0.95 < number / np.linalg.eigvalsh(certificate.P * np.outer(d, d))[0] < 1


def test_the_file_loses_no_digit(certificate, tmp_path):
    file = tmp_path / "c.json"
    file.write_text(certificate_json(certificate), encoding="utf-8")
    back, written = read_certificate(file)
    assert written == certificate_digest(certificate) == certificate_digest(back)
    for name in ("A", "B", "K", "P", "Qe", "Re", "Q", "scale", "poles"):
        assert np.array_equal(getattr(back, name), getattr(certificate, name)), name
    assert prove_certificate(back, written).holds
    assert max(len(line) for line in file.read_text().splitlines()) < 200


CHANGES = [(f, False) for f in ("A", "B", "K", "P", "Qe", "Re", "Q")]
CHANGES += [(f, True) for f in ("A", "C", "Q", "R", "P", "L")]


@pytest.mark.parametrize(("field", "inner"), CHANGES)
def test_one_changed_entry_breaks_it_with_a_number(certificate, field, inner):
    """Each nonzero entry in turn, by 1 %, and each zero one by 1 % of the largest; the digest is made anew."""
    whole = getattr(certificate.observer if inner else certificate, field)
    for i, j in np.ndindex(whole.shape):
        changed = whole.copy()
        changed[i, j] += 0.01 * (changed[i, j] or np.abs(whole).max())
        if inner:
            bad = certificate._replace(observer=certificate.observer._replace(**{field: changed}))
        else:
            bad = certificate._replace(**{field: changed})
        found = prove_certificate(bad, certificate_digest(bad))
        broken = [c for c in found.conditions if not c.holds]
        assert not found.holds, (field, i, j)
        assert any(np.isfinite(c.number) and c.number for c in broken), (field, i, j)


def test_a_tiny_change_is_seen_by_the_digest(certificate):
    text = certificate_json(certificate)
    content = json.loads(text)
    content["K"][0][0] = float(np.nextafter(content["K"][0][0], 1))
    back, written = parse_certificate(json.dumps(content), "c.json")
    found = prove_certificate(back, written)
    assert [c.name for c in found.conditions if not c.holds] == ["the file is as it was written"]


def test_a_destabilising_gain_is_no_matter_of_tolerance(certificate):
    broken = failing(certificate._replace(K=-certificate.K))
    assert {"(14)", "A + B K Hurwitz", "K = -R_e^-1 B'P", "V falls, gain K"} <= set(broken)
    assert broken["A + B K Hurwitz"].number < 0
    assert "pivot at" in broken["A + B K Hurwitz"].why


def test_numbers_that_are_recorded_are_held_to_their_limits(certificate):
    bad = certificate._replace(recorded={"kappa": RecordedNumber(1.2, 0.0, 1.0, "by hand")})
    assert failing(bad)["kappa"].number == 1.2
    bad = certificate._replace(observer=certificate.observer._replace(weight=0.98 * certificate.observer.weight))
    assert "(15)" in " ".join(failing(bad))
    bad = certificate._replace(poles=certificate.poles + 0.01)
    assert "recorded" in failing(bad)["poles of A + B K, as recorded"].why


def test_extreme_numbers_fail_and_do_not_raise(certificate):
    o = certificate.observer
    assert not prove_certificate(certificate._replace(observer=o._replace(Q=-o.Q))).holds
    for big in (1e49, 1e-49, 1e160, 1e308, 1e-308):
        changed = certificate.K.copy()
        changed[0, 0] = big
        assert not prove_certificate(certificate._replace(K=changed)).holds
        assert not prove_certificate(certificate._replace(Qe=big * np.eye(4))).holds
        assert not prove_certificate(certificate._replace(observer=o._replace(R=np.array([[big]])))).holds


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.pop("format"), "is no certificate: format None"),
        (lambda c: c.update(format="other"), "is no certificate: format 'other'"),
        (lambda c: c.pop("K"), "lacks 'K'"),
        (lambda c: c.update(P=[[1.0]]), r"shape \(1, 1\), wanted \(4, 4\)"),
        (lambda c: c.update(A="x"), "holds what is no certificate"),
        (lambda c: c.update(method="magic"), "'magic'"),
        (lambda c: c["observer"].update(estimated=["nothing", "else"]), "nothing"),
        (lambda c: c["scale"].__setitem__(0, -1.0), "scale"),
        (lambda c: c["K"][0].__setitem__(0, 1e999), "no number"),
    ],
)
def test_what_is_no_certificate_is_refused(certificate, change, words):
    content = json.loads(certificate_json(certificate))
    change(content)
    with pytest.raises(InputError, match=words) as refused:
        parse_certificate(json.dumps(content), "c.json")
    assert "trimtab design" in str(refused.value) or refused.value.choices


def test_files_that_cannot_be_read_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_certificate(tmp_path / "none.json")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it is no text"):
        read_certificate(tmp_path / "binary")
    with pytest.raises(InputError, match="is no JSON"):
        parse_certificate("{", "x")
    with pytest.raises(InputError, match="format 'list'"):
        parse_certificate("[]", "x")

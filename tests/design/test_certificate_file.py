"""Certificates as files: no digit is lost, and invalid files are rejected."""

import json

import numpy as np
import pytest
from design.systems import ball_system

from trimtab.core.errors import InputError
from trimtab.design.certificate import design_certificate
from trimtab.design.certificate_check import prove_certificate
from trimtab.design.certificate_file import (
    certificate_digest,
    certificate_json,
    parse_certificate,
    read_certificate,
)
from trimtab.design.poles import sorted_poles


@pytest.fixture(scope="module")
def certificate():
    return design_certificate(ball_system())


def test_json_round_trip_keeps_every_digit(certificate, tmp_path):
    file = tmp_path / "c.json"
    file.write_text(certificate_json(certificate), encoding="utf-8")
    back, written = read_certificate(file)
    assert written == certificate_digest(certificate) == certificate_digest(back)
    for name in ("A", "B", "K", "P", "Qe", "Re", "Q", "scale", "poles"):
        assert np.array_equal(getattr(back, name), getattr(certificate, name)), name
    assert prove_certificate(back, ball_system(), written).holds
    assert max(len(line) for line in file.read_text().splitlines()) < 200


def test_real_poles_survive_the_json_round_trip(certificate):
    real = certificate._replace(poles=sorted_poles(np.diag([-3.0, -1.0, -2.0, -4.0])))
    back, _ = parse_certificate(certificate_json(real), "c.json")
    assert np.array_equal(back.poles, [-1, -2, -3, -4])


def test_digest_detects_last_digit_change(certificate):
    content = json.loads(certificate_json(certificate))
    content["K"][0][0] = float(np.nextafter(content["K"][0][0], 1))
    back, written = parse_certificate(json.dumps(content), "c.json")
    proof = prove_certificate(back, ball_system(), written)
    assert [c.name for c in proof.conditions if not c.holds] == ["file unchanged since it was written"]


REFUSED = {
    "no format": (lambda c: c.pop("format"), "is not a certificate; its format is None"),
    "another format": (lambda c: c.update(format="other"), "is not a certificate; its format is 'other'"),
    "previous format": (lambda c: c.update(format="trimtab certificate 1"), "format is 'trimtab certificate 1'"),
    "no gain": (lambda c: c.pop("K"), "lacks 'K'"),
    "no digest": (lambda c: c.pop("digest"), "lacks 'digest'"),
    "no scope": (lambda c: c.pop("scope"), "lacks 'scope'"),
    "no weight of the filter": (lambda c: c["observer"].pop("weight"), r"lacks 'observer\.weight'"),
    "an unknown key": (lambda c: c.update(proof="trust me"), "unknown key 'proof'"),
    "an unknown key inside": (lambda c: c["observer"].update(holds=True), "unknown key observer.'holds'"),
    "a wider scope": (lambda c: c.update(scope=["everywhere"]), "scope: .*everywhere"),
    "another shape": (lambda c: c.update(P=[[1.0]]), r"must be numbers of shape \(4, 4\), got shape \(1, 1\)"),
    "rows of unlike length": (lambda c: c["A"][1].pop(), "A"),
    "text for a matrix": (lambda c: c.update(A="x"), "A"),
    "text for a number": (lambda c: c["K"][0].__setitem__(0, "1.0"), "K: .*numbers of shape"),
    "boolean for a number": (lambda c: c["B"][0].__setitem__(0, False), "B: .*numbers of shape"),
    "null for a number": (lambda c: c["observer"].update(weight=None), r"observer\.weight: .*numbers of shape"),
    "unknown method": (lambda c: c.update(method="magic"), "'magic'"),
    "method that does not fit the data": (lambda c: c.update(method="lmi"), "'lmi'"),
    "unknown states": (lambda c: c["observer"].update(estimated=["nothing", "else"]), "nothing"),
    "duplicate state": (lambda c: c["states"].__setitem__(0, "theta"), "states"),
    "numbers for names": (lambda c: c["inputs"].__setitem__(0, 1), "inputs"),
    "a size below zero": (lambda c: c["scale"].__setitem__(0, -1.0), "scale"),
    "a number too large for floats": (lambda c: c["K"][0].__setitem__(0, 1e999), "not a number"),
    "NaN entry": (lambda c: c["P"][0].__setitem__(0, float("nan")), "not a number"),
    "entry above 1e50": (lambda c: c["P"][0].__setitem__(0, 1e60), "larger than 1e[+]50"),
    "an integer beyond floats": (lambda c: c["P"][0].__setitem__(0, 10**400), "is not a (valid )?certificate"),
    "invalid version": (lambda c: c.update(version="best"), "must be a version such as 0.1.0, got 'best'"),
    "setting that is a list": (lambda c: c["about"].update(beam_m=[1.0]), r"about\.beam_m"),
    "recorded value that is a mapping": (lambda c: c["recorded"].update(kappa={"value": 0.1}), r"recorded\.kappa"),
    "a list for the settings": (lambda c: c.update(about=["h"]), "is not a (valid )?certificate"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_rejects_invalid_certificate(certificate, case):
    change, words = REFUSED[case]
    content = json.loads(certificate_json(certificate))
    change(content)
    with pytest.raises(InputError, match=words) as refused:
        parse_certificate(json.dumps(content), "c.json")
    assert "trimtab design" in str(refused.value) or refused.value.choices


def test_old_format_error_gives_the_command(certificate):
    with pytest.raises(InputError, match=r"trimtab design hypersonic --out old\.json  writes a new one"):
        parse_certificate('{"format": "trimtab certificate 1"}', "old.json")


def test_rejects_duplicate_keys(certificate):
    text = certificate_json(certificate)
    for key in ("K", "system", "estimated"):
        double = text.replace(f'"{key}":', f'"{key}": [[0.0]],\n "{key}":', 1)
        with pytest.raises(InputError, match=f"'{key}' appears twice"):
            parse_certificate(double, "c.json")


def test_rejects_unreadable_files(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_certificate(tmp_path / "none.json")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="it is not a text file"):
        read_certificate(tmp_path / "binary")
    for text in ("{", "[" * 100_000):
        with pytest.raises(InputError, match="is not valid JSON"):
            parse_certificate(text, "x")
    with pytest.raises(InputError, match="format is 'list'"):
        parse_certificate("[]", "x")

"""`trimtab design VEHICLE --lqr`: a gain from limits, its proof, the proof from its file, and assumed parameters."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from trimtab.cli import main
from trimtab.design.certificate_file import certificate_json, read_certificate

CART = "examples/my_cart.py:scenario"
WORDS = ("--limit", "force=5", "--limit", "lean=6 deg", "--limit", "position=30 cm")
WORDS += ("--limit", "velocity=1", "--limit", "lean_rate=60 deg/s")


def call(*words):
    return CliRunner().invoke(main, ["design", *map(str, words)])


def data(*words):
    done = call(*words, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    file = tmp_path_factory.mktemp("gain") / "gain.json"
    found = data(CART, "--lqr", *WORDS, "--integrate", "position=0.5", "--out", file)
    assert found["files"] == [str(file)]
    return file


@pytest.mark.thorough
def test_lqr_gain_is_proved_again_from_its_file(file):
    done = call(CART, "--lqr", "--check", file)
    assert done.exit_code == 0, done.output
    assert "23 of 23 conditions proved exactly" in done.output


def test_modified_gain_fails_the_proof(file, tmp_path):
    certificate, _ = read_certificate(file)
    wrong = tmp_path / "wrong.json"
    wrong.write_text(certificate_json(certificate._replace(K=certificate.K * [[1, 1, 0, 1, 1]])), encoding="utf-8")
    done = call(CART, "--lqr", "--check", wrong)
    assert done.exit_code == 1, done.output
    assert "NOT proved: A + B K Hurwitz" in done.output


@pytest.mark.thorough
def test_assumed_parameter_changes_the_gain():
    own, heavy = data(CART, "--lqr", *WORDS), data(CART, "--lqr", *WORDS, "--assume", "bob=0.5")
    assert heavy["about"]["assume"] == "bob=0.5"
    assert not np.allclose(own["K"], heavy["K"], rtol=1e-3)


@pytest.mark.thorough
def test_invalid_arguments_are_rejected():
    for words, wanted in (
        ((CART, "--lqr"), "--limit force=NUMBER"),
        ((CART, "--lqr", "--limit", "force=5", "--limit", "leen=1"), "no such state"),
        ((CART, "--limit", "force=5"), "add --lqr"),
        ((CART, "--lqr", "--method", "lmi", *WORDS), "leave --method out"),
        ((CART, "--lqr", "--limit", "force"), "NAME=VALUE"),
        (("--lqr",), "VEHICLE is missing"),
        ((CART, "--lqr", *WORDS, "--assume", "bib=1"), "bob"),
    ):
        done = call(*words)
        assert done.exit_code == 2, (words, done.output)
        assert wanted in done.output, (words, done.output)

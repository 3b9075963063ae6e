"""A linear model is read back from its file to the last digit; invalid files are rejected."""

import json

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.design.linear_file import linear_json, read_linear
from trimtab.design.linearise import linearise
from trimtab.design.model import model_of_functions


@pytest.fixture
def linear():
    A = np.array([[0.1, 1 / 3], [-np.pi, -0.7]])
    model = model_of_functions(lambda x, u: A @ x + u[0], ("a", "b"), ("u",), h=lambda x, u: x[:1] * u, outputs=("y",))
    return linearise(model, [0.2, 0.4], [1e-17])


def test_linear_model_file_round_trips_exactly(linear, tmp_path):
    file = tmp_path / "model.json"
    file.write_text(linear_json(linear, {"vehicle": "cart"}), encoding="utf-8")
    back, about = read_linear(file)
    assert about == {"vehicle": "cart"}
    for name, own in linear._asdict().items():
        np.testing.assert_array_equal(getattr(back, name), own)


@pytest.mark.parametrize(
    "change", [{"format": "?"}, {"A": [[1.0]]}, {"states": ["a"]}, {"B": None}, {"D": [[float("nan")]]}]
)
def test_rejects_invalid_model_file(linear, tmp_path, change):
    file = tmp_path / "model.json"
    file.write_text(json.dumps(json.loads(linear_json(linear, {})) | change), encoding="utf-8")
    with pytest.raises(InputError, match=r"trimtab linearise VEHICLE --out model\.json"):
        read_linear(file)
    with pytest.raises(InputError, match="cannot be read"):
        read_linear(tmp_path / "none.json")

"""Text files of linear models, without loss of digits: matrices, names, operating point, and origin of the model."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.core.errors import InputError
from trimtab.core.user_file import read_user_text
from trimtab.design.linearise import LinearModel

FORMAT = "trimtab linear model"
MATRICES = ("A", "B", "C", "D")
VECTORS = ("x0", "u0", "y0", "drift")
NAMES = ("states", "inputs", "outputs")


def linear_json(linear: LinearModel, about: dict[str, Any]) -> str:
    """Return the text of a file with a linear model. about: further content, e.g. the vehicle's name and operating
    point."""
    numbers = {n: np.asarray(getattr(linear, n), float).tolist() for n in (*MATRICES, *VECTORS)}
    names = {n: list(getattr(linear, n)) for n in NAMES}
    return json.dumps({"format": FORMAT, "about": about, **names, **numbers}, indent=1) + "\n"


def read_linear(file: Path) -> tuple[LinearModel, dict[str, Any]]:
    """Return the linear model in a file, and the file's further content.

    Raises: InputError if the file does not contain a linear model, or its matrices and names don't match.
    """
    fix = "trimtab linearise VEHICLE --out model.json  writes a linear model"
    try:
        data: Any = json.loads(read_user_text(file))
        if data.get("format") != FORMAT:
            raise InputError(str(file), "is not a linear model", fix=fix)
        names = {n: tuple(str(word) for word in data[n]) for n in NAMES}
        n, m, p = (len(names[k]) for k in NAMES)
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m), "x0": (n,), "u0": (m,), "y0": (p,), "drift": (n,)}
        numbers = {k: np.asarray(data[k], float).reshape(shape) for k, shape in shapes.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(str(file), f"cannot be read as a linear model: {error}", fix=fix) from None
    bad = [k for k, value in numbers.items() if not np.isfinite(value).all()]
    if bad:
        raise InputError(str(file), f"all entries of {', '.join(bad)} must be finite", fix=fix)
    return LinearModel(**numbers, **names), data.get("about", {})

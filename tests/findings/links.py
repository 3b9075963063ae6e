"""Findings about links, which include the export to C."""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from findings.finding import Finding, Outcome
from trimtab.compiler.compiled_function import export_callable
from trimtab.export.verify import verify_folder

KEYS = ("a b", "a_b", "a-b", "errno", "1e5", "", "*/", "π", "NAN", "int")


def similar_keys() -> Outcome:
    """Export functions of dicts whose keys become similar names, and compare with JAX."""
    texts = []
    for keys in (("a b", "a_b"), KEYS):
        example = {key: float(k + 1) for k, key in enumerate(keys)}
        with tempfile.TemporaryDirectory() as folder:
            export_callable(lambda x: sum(v * (i + 2) for i, v in enumerate(x.values())), (example,), Path(folder))
            texts.append(verify_folder(Path(folder)).good)
    return Outcome(f"verified: {texts}", all(texts))


def verified_with(compiler: str) -> bool:
    """Verify exports that were condemned, with this compiler."""
    before = os.environ.get("CC")
    os.environ["CC"] = compiler
    cases: list[tuple[Any, tuple[Any, ...]]] = [
        (lambda x: (jnp.sin(x), jnp.exp(x), jnp.power(x, x)), (0.5,)),
        (lambda a: a + 1, (np.int64(2**53 + 1),)),
        (lambda x: jnp.cumsum(jnp.sin(x)), (np.ones(300, np.float32),)),
        (lambda: jnp.arange(3.0), ()),
    ]
    good = []
    try:
        for function, example in cases:
            with tempfile.TemporaryDirectory() as folder:
                export_callable(function, example, Path(folder))
                good.append(verify_folder(Path(folder)).good)
    finally:
        os.environ.pop("CC")
        os.environ.update({} if before is None else {"CC": before})
    return all(good)


def correct_exports() -> Outcome:
    """Verify correct exports with each compiler of this machine."""
    found = {name: verified_with(name) for name in ("gcc", "clang") if shutil.which(name)}
    return Outcome(f"verified: {found}", all(found.values()))


FINDINGS = [
    Finding(
        "L15",
        'export of x["a b"] + 10 x["a_b"] and of keys such as "errno", "", "*/"',
        "the C gives 22, not 21; other keys do not compile",
        similar_keys,
    ),
    Finding(
        "L16",
        "check of exports with sine, int64 above 2**53, float32, no arguments; by gcc and clang",
        "refused or condemned: -Werror of clang, double's tolerance, rows through double",
        correct_exports,
    ),
]

"""Export of a campaign's results, one row for each run, to a Parquet file, together with the campaign's plan.

Source: Apache Parquet, file format, key-value metadata; Apache Arrow, format, schemas.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from trimtab.analysis.campaign.campaign import CampaignResult
from trimtab.core.errors import InputError, install_command

ABOUT = b"trimtab"
"""Metadata key of the JSON text that describes the campaign."""


def write_parquet(result: CampaignResult, file: str | Path) -> Path:
    """Write a campaign's results to a Parquet file, together with plan, version, backend and class of machine."""
    return write_columns(result.columns, {"identity": result.identity, "plan": result.plan.as_dict()}, file)


def write_columns(columns: Mapping[str, Any], about: Mapping[str, Any], file: str | Path) -> Path:
    """Write columns to a Parquet file, atomically.

    Args:
        columns: name -> values (n,), as `read_store` returns them.
        about: JSON-compatible data stored with the rows, e.g. the attributes of a store.
        file: path of the file. An existing file is replaced.
    """
    pa, parquet = import_arrow()
    file = Path(file)
    rows = {name: np.ascontiguousarray(column) for name, column in columns.items()}
    table = pa.table(rows).replace_schema_metadata({ABOUT: json.dumps(about, sort_keys=True)})
    part = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        parquet.write_table(table, part, compression="zstd")
        part.replace(file)
    except OSError as error:
        part.unlink(missing_ok=True)
        problem = f"cannot be written: {error.strerror or error}"
        raise InputError(f"parquet {str(file)!r}", problem, fix="free disk space, or name another file") from None
    return file


def import_arrow() -> tuple[Any, Any]:
    """Import pyarrow and its parquet module. If they are missing, raise InputError with the install command."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError("parquet", "needs pyarrow", fix=install_command("parquet")) from None
    return pyarrow, pyarrow.parquet

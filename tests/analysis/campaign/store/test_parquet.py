"""Exported rows of a campaign are read back unchanged, together with its plan and identity."""

import json

import numpy as np
import pyarrow.parquet
import pytest
from analysis.campaign.small import BLOCK, assert_same, small

from trimtab.analysis.campaign.store.parquet import write_columns, write_parquet
from trimtab.analysis.campaign.store.store import read_store
from trimtab.analysis.campaign.workers.prepare import plan_from_dict
from trimtab.core.errors import InputError

COLUMNS = {
    "run": np.arange(5),
    "world.vehicle.mass": np.array([2.6, 1e-300, -0.0, np.nextafter(1, 2), 3.0]),
    "settling:yaw_rate": np.array([1.0, np.inf, np.nan, -np.inf, 0.1 + 0.2]),
    "success": np.array([True, False, True, True, False]),
}


def read(file):
    """Description and columns of a file, as any program reads it."""
    table = pyarrow.parquet.read_table(file)
    return json.loads(table.schema.metadata[b"trimtab"]), {n: table[n].to_numpy() for n in table.column_names}


@pytest.mark.thorough
def test_store_rows_round_trip_through_parquet_exactly(tmp_path):
    of = small(2 * BLOCK)
    of.run(tmp_path / "rows.zarr")
    about, columns = read_store(tmp_path / "rows.zarr")
    write_columns(columns, about, tmp_path / "rows.parquet")
    told, found = read(tmp_path / "rows.parquet")
    assert_same(found, columns)
    assert told == about
    assert plan_from_dict(told["plan"]) == of.plan
    assert {"version", "machine", "backend", "scenario"} <= set(told["identity"])
    assert [f.name for f in tmp_path.iterdir() if f.name.startswith(".")] == []


@pytest.mark.thorough
def test_result_rows_round_trip_through_parquet(tmp_path):
    of = small(BLOCK)
    result = of.run()
    write_parquet(result, tmp_path / "rows.parquet")
    told, found = read(tmp_path / "rows.parquet")
    assert_same(found, result.columns)
    assert plan_from_dict(told["plan"]) == of.plan
    of.run(tmp_path / "rows.zarr")
    about = read_store(tmp_path / "rows.zarr")[0]
    assert told == {name: about[name] for name in ("identity", "plan")}


def test_nan_and_infinity_round_trip_bit_for_bit(tmp_path):
    write_columns(COLUMNS, {"seed": 1}, tmp_path / "a.parquet")
    write_columns(COLUMNS, {"seed": 2}, tmp_path / "a.parquet")
    told, found = read(tmp_path / "a.parquet")
    assert told == {"seed": 2}
    for name, column in COLUMNS.items():
        assert found[name].dtype == column.dtype
        assert found[name].tobytes() == column.tobytes()
    plain = pyarrow.parquet.read_table(tmp_path / "a.parquet").to_pydict()  # as anybody's program reads it
    assert plain["success"] == [True, False, True, True, False]
    assert plain["world.vehicle.mass"][4] == 3.0


def test_rejects_a_file_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_columns(COLUMNS, {}, tmp_path / "no" / "c.parquet")

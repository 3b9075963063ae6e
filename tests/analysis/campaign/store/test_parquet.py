"""Rows that leave a campaign are the same when they are read back, with what decided them."""

import json

import numpy as np
import pyarrow.parquet
import pytest
from analysis.campaign.small import BLOCK, assert_same, small

from trimtab.analysis.campaign.store.parquet import as_dataset, read_parquet, write_columns, write_parquet
from trimtab.analysis.campaign.store.store import read_store
from trimtab.analysis.campaign.workers.prepare import plan_from_dict
from trimtab.core.errors import InputError

COLUMNS = {
    "run": np.arange(5),
    "world.vehicle.mass": np.array([2.6, 1e-300, -0.0, np.nextafter(1, 2), 3.0]),
    "settling:yaw_rate": np.array([1.0, np.inf, np.nan, -np.inf, 0.1 + 0.2]),
    "success": np.array([True, False, True, True, False]),
}


@pytest.mark.thorough
def test_rows_of_a_store_come_back_bit_for_bit(tmp_path):
    of = small(2 * BLOCK)
    of.run(tmp_path / "rows.zarr")
    about, columns = read_store(tmp_path / "rows.zarr")
    write_columns(columns, about, tmp_path / "rows.parquet")
    told, found = read_parquet(tmp_path / "rows.parquet")
    assert_same(found, columns)
    assert told == about
    assert plan_from_dict(told["plan"]) == of.plan
    assert {"version", "machine", "backend", "scenario"} <= set(told["identity"])
    assert [f.name for f in tmp_path.iterdir() if f.name.startswith(".")] == []


@pytest.mark.thorough
def test_rows_of_a_result(tmp_path):
    of = small(BLOCK)
    result = of.run()
    write_parquet(result, tmp_path / "rows.parquet")
    told, found = read_parquet(tmp_path / "rows.parquet")
    assert_same(found, result.columns)
    assert plan_from_dict(told["plan"]) == of.plan
    of.run(tmp_path / "rows.zarr")
    about = read_store(tmp_path / "rows.zarr")[0]
    assert told == {name: about[name] for name in ("identity", "plan")}


def test_numbers_that_are_no_numbers(tmp_path):
    write_columns(COLUMNS, {"seed": 1}, tmp_path / "a.parquet")
    write_columns(COLUMNS, {"seed": 2}, tmp_path / "a.parquet")
    told, found = read_parquet(tmp_path / "a.parquet")
    assert told == {"seed": 2}
    for name, column in COLUMNS.items():
        assert found[name].dtype == column.dtype
        assert found[name].tobytes() == column.tobytes()
    plain = pyarrow.parquet.read_table(tmp_path / "a.parquet").to_pydict()  # as anybody's program reads it
    assert plain["success"] == [True, False, True, True, False]
    assert plain["world.vehicle.mass"][4] == 3.0


def test_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_parquet(tmp_path / "none.parquet")
    (tmp_path / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match="cannot be read"):
        read_parquet(tmp_path / "a.parquet")
    pyarrow.parquet.write_table(pyarrow.table({"a": [1]}), tmp_path / "b.parquet")
    with pytest.raises(InputError, match="does not hold a campaign"):
        read_parquet(tmp_path / "b.parquet")
    with pytest.raises(InputError, match="cannot be written"):
        write_columns(COLUMNS, {}, tmp_path / "no" / "c.parquet")


@pytest.mark.thorough
def test_dataset_over_runs():
    made = as_dataset(COLUMNS, {"seed": 1})
    assert dict(made.sizes) == {"run": 5}
    assert json.loads(made.attrs["trimtab"]) == {"seed": 1}
    assert made["settling:yaw_rate"].sel(run=3) == -np.inf
    assert np.array_equal(made["success"].values, COLUMNS["success"])

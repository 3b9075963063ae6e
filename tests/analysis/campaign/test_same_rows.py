"""A row is the same bit for bit with any threads, blocks, store or workers."""

import pytest
from analysis.campaign.small import BLOCK, assert_same, small

from trimtab.analysis.campaign.campaign import Campaign
from trimtab.core.errors import InputError

RUNS = 20 * BLOCK - 5


@pytest.fixture(scope="module")
def whole():
    """Columns of the campaign in memory."""
    return small(RUNS).run().columns


@pytest.fixture
def store(tmp_path):
    return tmp_path / "rows.zarr"


@pytest.mark.thorough("how0", "how4")
@pytest.mark.parametrize("how", [{"threads": 1}, {"threads": 2}, {"block": 128}, {"block": 1000}, {"store": True}])
def test_rows_are_independent_of_threads_blocks_and_store(how, whole, store):
    of = small(RUNS, block=how.get("block", BLOCK))
    assert_same(of.run(store if "store" in how else None, threads=how.get("threads")).columns, whole)


@pytest.mark.thorough
def test_jax_rows_are_independent_of_block_size():
    """Half a minute: four programs are compiled."""
    wanted = small(130, block=2048).run(backend="jax").columns
    assert_same(small(130, block=40).run(backend="jax").columns, wanted)


@pytest.mark.thorough
def test_row_equals_a_single_run(whole):
    of = small(RUNS)
    for run in (0, 77, RUNS - 1):
        row = of.row(run, of.rerun(run))
        assert {n: row[n] for n in row} == {n: whole[n][run] for n in row}


def test_remote_workers_reject_unnamed_objects_and_functions():
    by_object = Campaign(small(1).scenario(0), runs=64)
    for of in (by_object, small(64, metrics=[lambda rows: rows["yaw_rate"][:, -1]])):
        with pytest.raises(InputError, match="an object or a function of this program can't be sent") as refused:
            of.run(workers=lambda *_: iter(()))
        assert "file.py:function" in refused.value.fix

"""A store believes only what is sound and its own."""

import json

import pytest
from campaign.small import BLOCK, assert_same, small
from zarr.storage import LocalStore

from trimtab.campaign.store.store import read_store
from trimtab.core.errors import InputError

RUNS = 4 * BLOCK


@pytest.fixture(scope="module")
def whole():
    """Columns of the campaign in memory."""
    return small(RUNS).run().columns


@pytest.fixture
def store(tmp_path):
    return tmp_path / "rows.zarr"


def test_store_of_another_campaign(store):
    small(2 * BLOCK).run(store)
    for other in ({"seed": 4}, {"metrics": ["peak:yaw_rate"]}, {"spread": {"world.vehicle.mass": "normal(100%, 5%)"}}):
        with pytest.raises(InputError, match="rows of another campaign: campaign") as refused:
            small(2 * BLOCK, **other).run(store)
        assert "OTHER.zarr" in refused.value.fix
    folder = store.parent / "photographs"
    (folder / "2024").mkdir(parents=True)
    (folder / "2024" / "cat.png").write_bytes(b"cat")
    with pytest.raises(InputError, match="other things in it"):
        small(2 * BLOCK).run(folder)
    assert (folder / "2024" / "cat.png").read_bytes() == b"cat"


def test_metric_of_a_file_that_was_changed(store, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].max(axis=1)\n")
    asked = {"metrics": [f"{file}:worst"]}
    small(BLOCK, **asked).run(store)
    assert small(BLOCK, **asked).run(store).flown_runs == 0
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].min(axis=1)\n")
    with pytest.raises(InputError, match="another campaign: files"):
        small(BLOCK, **asked).run(store)


TORN = {"half": lambda b: b[: len(b) // 2], "empty": lambda b: b"", "zeros": lambda b: bytes(len(b)), "gone": None}
CHUNKS = [(column, torn) for column in ("error_rms:yaw_rate", "success", "done") for torn in TORN]


@pytest.mark.parametrize(("column", "torn"), CHUNKS)
def test_chunk_that_a_crash_of_the_machine_tore(store, whole, column, torn):
    small(4 * BLOCK).run(store)
    chunk, spoil = store / column / "c" / "2", TORN[torn]
    if spoil:
        chunk.write_bytes(spoil(chunk.read_bytes()))
        with pytest.raises(InputError, match=r"damaged(.|\n)*start the command that made it again"):
            read_store(store)
    else:
        chunk.unlink()
    again = small(4 * BLOCK).run(store)
    assert again.flown_runs == BLOCK
    assert_same(again.columns, {n: c[: 4 * BLOCK] for n, c in whole.items()})


def test_a_description_is_whole_or_not_there_whenever_its_process_is_killed(store, monkeypatch):
    seen, write = [], LocalStore.set

    async def see(self, key, value):
        await write(self, key, value)
        if key == "zarr.json":
            seen.append(set(json.loads((store / key).read_text())["attributes"]))

    monkeypatch.setattr(LocalStore, "set", see)
    small(BLOCK).run(store)
    assert [keys for keys in seen if keys] == [set(read_store(store)[0])]


def test_what_killed_processes_leave_is_no_hindrance(store, monkeypatch, whole):
    def killed(*_):
        raise SystemExit

    with monkeypatch.context() as patched:
        patched.setattr("zarr.Group.update_attributes", killed)  # nothing says yet whose the arrays are
        with pytest.raises(SystemExit):
            small(BLOCK).run(store)
    assert (store / "done" / "zarr.json").exists()
    left = store / "done" / "zarr.0123.partial"
    left.write_bytes(b"half")
    assert_same(small(BLOCK).run(store).columns, {n: c[:BLOCK] for n, c in whole.items()})
    assert not left.exists()
    (store / "zarr.json").write_text('{"zarr_fo')
    with pytest.raises(InputError, match="damaged"):
        small(BLOCK).run(store)

"""A store accepts only undamaged data of its own campaign."""

import json

import pytest
from analysis.campaign.small import BLOCK, assert_same, small
from zarr.storage import LocalStore

from trimtab.analysis.campaign.store.store import estimate_store_size, read_store
from trimtab.core.errors import InputError

RUNS = 4 * BLOCK


@pytest.fixture(scope="module")
def whole():
    """Columns of the campaign in memory."""
    return small(RUNS).run().columns


@pytest.fixture
def store(tmp_path):
    return tmp_path / "rows.zarr"


@pytest.mark.thorough
def test_rejects_store_of_another_campaign(store):
    small(2 * BLOCK).run(store)
    for other in ({"seed": 4}, {"metrics": ["peak:yaw_rate"]}, {"spread": {"world.vehicle.mass": "normal(100%, 5%)"}}):
        with pytest.raises(InputError, match="rows of another campaign; different: campaign") as refused:
            small(2 * BLOCK, **other).run(store)
        assert "OTHER.zarr" in refused.value.fix
    folder = store.parent / "photographs"
    (folder / "2024").mkdir(parents=True)
    (folder / "2024" / "cat.png").write_bytes(b"cat")
    with pytest.raises(InputError, match="do not belong to a campaign's store"):
        small(2 * BLOCK).run(folder)
    assert (folder / "2024" / "cat.png").read_bytes() == b"cat"


@pytest.mark.thorough
def test_rejects_store_after_metric_file_change(store, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].max(axis=1)\n")
    asked = {"metrics": [f"{file}:worst"]}
    small(BLOCK, **asked).run(store)
    assert small(BLOCK, **asked).run(store).flown_runs == 0
    file.write_text("def worst(rows):\n    return rows['yaw_rate'].min(axis=1)\n")
    with pytest.raises(InputError, match="another campaign; different: files"):
        small(BLOCK, **asked).run(store)


TORN = {"half": lambda b: b[: len(b) // 2], "empty": lambda b: b"", "zeros": lambda b: bytes(len(b)), "gone": None}
CHUNKS = [(column, torn) for column in ("error_rms:yaw_rate", "success", "done") for torn in TORN]


@pytest.mark.thorough
@pytest.mark.parametrize(("column", "torn"), CHUNKS)
def test_torn_chunk_is_detected_and_flown_again(store, whole, column, torn):
    small(4 * BLOCK).run(store)
    chunk, spoil = store / column / "c" / "2", TORN[torn]
    if spoil:
        chunk.write_bytes(spoil(chunk.read_bytes()))
        with pytest.raises(InputError, match=r"damaged(.|\n)*start the command that made the store again"):
            read_store(store)
    else:
        chunk.unlink()
    again = small(4 * BLOCK).run(store)
    assert again.flown_runs == BLOCK
    assert_same(again.columns, {n: c[: 4 * BLOCK] for n, c in whole.items()})


@pytest.mark.thorough
def test_store_description_is_written_atomically(store, monkeypatch):
    seen, write = [], LocalStore.set

    async def see(self, key, value):
        await write(self, key, value)
        if key == "zarr.json":
            seen.append(set(json.loads((store / key).read_text())["attributes"]))

    monkeypatch.setattr(LocalStore, "set", see)
    small(BLOCK).run(store)
    assert [keys for keys in seen if keys] == [set(read_store(store)[0])]


@pytest.mark.thorough
def test_leftovers_of_killed_processes_are_cleaned_up(store, monkeypatch, whole):
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


def test_metric_name_longer_than_a_file_name_is_stored(store):
    long = "robustness:" + " and ".join(f"always(abs(truth.yaw_rate) < {k} rad/s)" for k in range(40, 60))
    other = long.replace("< 59", "< 58.5")
    found = small(BLOCK, metrics=[long, other]).run(store).columns
    read = read_store(store)[1]
    assert found[long].tobytes() == read[long].tobytes()
    assert found[other].tobytes() == read[other].tobytes()


@pytest.mark.thorough
def test_store_size_is_estimated_from_the_first_block(store):
    runs = RUNS + BLOCK // 2
    assert estimate_store_size(store, runs) is None
    assert small(runs).run(store, stop=lambda _: True).flown_runs == BLOCK
    estimate = estimate_store_size(store, runs)
    small(runs).run(store)
    size = sum(f.stat().st_size for f in store.rglob("*") if f.is_file())
    assert size / 2 < estimate < 2 * size
    assert abs(estimate_store_size(store, runs) - size) < 0.01 * size
    head = sum(f.stat().st_size for f in store.rglob("zarr.json"))
    one_block = sum(f.stat().st_size for f in store.rglob("0"))
    assert estimate_store_size(store, BLOCK) == head + one_block

import copy
import dataclasses
import json
import pickle
import sys
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.quantity import Quantity
from trimtab.core.time import to_seconds
from trimtab.logs.log import LazyMapping, Log, check_log, to_plain


def small(n: int = 5, **changes) -> Log:
    ticks = np.arange(n) * 10_000
    parts = {
        "t": ticks / 1e7,
        "ticks": ticks,
        "signals": {
            "truth.heading": np.linspace(0.0, 1.0, n),
            "truth.p_WB": np.arange(3.0 * n).reshape(n, 3),
            "law.mode": np.arange(n, dtype=np.int32) % 2,
            "uplink.fresh": np.arange(n) % 2 == 0,
        },
        "declarations": {
            "truth.heading": Quantity("rad", "Angle from north.", kind="angle"),
            "law.mode": Quantity("1", "Which law.", kind="mode", modes=("damp", "full turn")),
            "uplink.fresh": Quantity("1", "New.", kind="flag"),
        },
        "metadata": {"scenario": "hovercraft/spin", "seed": 3, "parameters": {"world.vehicle.mass": np.float64(2.6)}},
        "final": {"truth.heading": 1.25, "truth.p_WB": [1.0, 2.0, 3.0]},
    }
    return Log(**(parts | changes))


def test_signals_keep_their_type_and_order():
    log = small()
    assert log.paths == ("truth.heading", "truth.p_WB", "law.mode", "uplink.fresh")
    assert len(log) == 5
    assert [log[p].dtype for p in log.paths] == [np.float64, np.float64, np.int32, np.bool_]
    assert log["truth.p_WB"].shape == (5, 3)
    np.testing.assert_array_equal(log["truth.heading"], [0, 0.25, 0.5, 0.75, 1])
    assert log.final["truth.heading"] == 1.25
    np.testing.assert_array_equal(log.final["truth.p_WB"], [1, 2, 3])


def test_log_is_immutable_and_owns_its_arrays():
    source = np.zeros(5)
    log = small(signals={"truth.heading": source})
    source[:] = 7
    assert not log["truth.heading"].any()
    for array in (log.t, log.ticks, log["truth.heading"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(TypeError):
        log.signals["truth.new"] = source  # pyright: ignore[reportIndexIssue]
    with pytest.raises(dataclasses.FrozenInstanceError):
        log.t = source  # pyright: ignore[reportAttributeAccessIssue]


def test_lazy_mapping_computes_each_value_once_on_access():
    made = []

    class Rows:
        def column(self, name):
            made.append(name)
            return name.upper()

    rows = Rows()
    gone = weakref.ref(rows)
    lazy = LazyMapping({"a": 1, "b": 2, "c": 3}, rows.column)
    del rows
    assert list(lazy) == ["a", "b", "c"]
    assert "b" in lazy
    assert "d" not in lazy
    assert made == []
    assert [lazy["b"], lazy["b"], lazy["a"]] == ["B", "B", "A"]
    assert made == ["b", "a"]
    assert gone() is not None
    assert lazy == {"a": "A", "b": "B", "c": "C"}
    assert made == ["b", "a", "c"]
    assert gone() is None
    for _ in range(2):
        with pytest.raises(KeyError):
            lazy["d"]
    with pytest.raises(TypeError):
        lazy["a"] = "x"  # pyright: ignore[reportIndexIssue]


def test_lazy_mapping_gives_all_threads_the_same_values():
    for _ in range(20):
        lazy = LazyMapping(dict.fromkeys(range(50)), lambda name: [name])
        with ThreadPoolExecutor(8) as pool:
            read = list(pool.map(lambda _, lazy=lazy: [lazy[name] for name in lazy], range(8)))
        assert all(a is b for other in read for a, b in zip(read[0], other, strict=True))


def test_time_equals_the_ticks_in_seconds():
    ticks = np.array([0, 3, 65_536, 123_456_789])
    log = small(ticks=ticks, t=ticks / 1e7, signals={"truth.x": np.zeros(4)})
    assert log.ticks.dtype == np.int64
    np.testing.assert_array_equal(log.t, to_seconds(ticks))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("truth.headin", "truth.heading"),
        ("estimate.heading", "truth.heading"),
        ("truth", "group of signals"),
        ("zzz", "not in this log"),
    ],
)
def test_unknown_path_error_lists_the_closest_paths(name, says):
    with pytest.raises(InputError, match=says) as refused:
        small()[name]
    assert refused.value.choices
    assert all(choice in small() for choice in refused.value.choices)
    with pytest.raises(InputError):
        small().unit(name)


def test_unit_of_each_signal():
    log = small()
    assert [log.unit(p) for p in log.paths] == ["rad", "", "1", "1"]


def test_between_is_half_open_and_keeps_the_rest():
    log = small(n=100)
    part = log.between(0.01, 0.02)
    np.testing.assert_array_equal(part.ticks, np.arange(10, 20) * 10_000)
    np.testing.assert_array_equal(part["truth.p_WB"], log["truth.p_WB"][10:20])
    assert part.metadata == log.metadata
    assert part.declarations == log.declarations
    assert part.final["truth.heading"] == 1.25
    pieces = [log.between(a, b) for a, b in ((0, 0.03), (0.03, 0.07), (0.07, np.inf))]
    np.testing.assert_array_equal(np.concatenate([p.ticks for p in pieces]), log.ticks)
    assert len(log.between(0.05, 0.01)) == 0
    assert len(log.between(-np.inf, np.inf)) == 100


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"t": np.arange(5.0)}, "same instants"),
        ({"t": np.zeros(4)}, "same instants"),
        ({"ticks": np.arange(5) * 1e4}, "float64"),
        ({"ticks": np.array([0, 2, 2, 3, 4]), "t": np.zeros(5)}, "rise strictly"),
        ({"ticks": np.array([-1, 2, 3, 4, 5]), "t": np.zeros(5)}, "rise strictly"),
        ({"signals": {"truth.x": np.zeros(4)}}, r"shape \(4,\), but the log has 5"),
        ({"signals": {"truth.x": np.zeros((5, 2, 2))}}, "shape"),
        ({"signals": {"truth.x": np.array(list("abcde"))}}, "has values of type"),
        ({"signals": {"truth.x": np.zeros(5, complex)}}, "has values of type"),
        ({"signals": {"heading": np.zeros(5)}}, "does not name a block and a field"),
        ({"signals": {"truth..x": np.zeros(5)}}, "does not name a block and a field"),
        ({"signals": {"a.b": np.zeros(5), "a.b.c": np.zeros(5)}}, "also the group"),
        ({"signals": {}}, "no signal"),
        ({"metadata": {"parameters": {"law": object()}}}, "log.metadata.parameters.law"),
        ({"metadata": {3: 1}}, "not text"),
    ],
)
def test_rejects_inconsistent_times_and_signals(changes, says):
    with pytest.raises(InputError, match=says):
        small(**changes)


def test_metadata_is_converted_to_plain_json_types():
    mixed = {"a": (1, np.int64(2)), "b": np.arange(3.0), "c": np.bool_(True), "d": None, "e": np.str_("x")}
    log = small(metadata=mixed)
    assert dict(log.metadata) == {"a": [1, 2], "b": [0.0, 1.0, 2.0], "c": True, "d": None, "e": "x"}
    assert type(log.metadata["c"]) is bool
    assert json.loads(json.dumps(dict(log.metadata))) == dict(log.metadata)
    assert type(to_plain("x", np.float64(1.5))) is float


def test_log_survives_deepcopy_and_pickle():
    log = small()
    for other in (copy.deepcopy(log), pickle.loads(pickle.dumps(log))):
        assert other.paths == log.paths
        assert dict(other.metadata) == dict(log.metadata)
        assert dict(other.declarations) == dict(log.declarations)
        np.testing.assert_array_equal(other["truth.p_WB"], log["truth.p_WB"])


def test_repr_shows_signals_units_and_usage():
    text = repr(small())
    assert "hovercraft/spin: 5 samples, 0 to 0.004 s, 4 signals" in text
    assert "truth.heading [rad]" in text
    assert 'log["truth.heading"]' in text
    assert "0 samples" in repr(small().between(5, 6))


@pytest.mark.thorough
def test_to_xarray_keeps_units_and_descriptions():
    data = small().to_xarray()
    assert data["truth.heading"].dims == ("time",)
    assert data["truth.p_WB"].dims == ("time", "component_3")
    assert data["truth.heading"].attrs == {"units": "rad", "long_name": "Angle from north."}
    assert data["law.mode"].attrs["flag_meanings"] == "damp full_turn"
    np.testing.assert_array_equal(data["law.mode"].attrs["flag_values"], [0, 1])
    assert data["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(data["time"], small().t)
    assert data.attrs["seed"] == 3
    assert json.loads(data.attrs["parameters"]) == {"world.vehicle.mass": 2.6}
    assert float(data["truth.heading"].sel(time=0.003, method="nearest")) == 0.75


def test_missing_xarray_error_names_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError) as refused:
        small().to_xarray()
    assert 'pip install "trimtab[xarray]"' in str(refused.value)


MEMBERS = {
    "plot": "plot_run(log)",
    "save": "write_log(log",
    "to_csv": "log.to_dataframe().to_csv",
    "time": "log.t",
    "keys": "log.paths",
    "truth": 'log["truth.heading"]',
    "heading": 'log["truth.heading"]',
    "scenario": 'log.metadata["scenario"]',
    "betwen": "between",
    "anything": "print(log.paths)",
}


@pytest.mark.parametrize("name", MEMBERS)
def test_unknown_attribute_error_suggests_a_replacement(name):
    log = small(metadata={"scenario": "own", "duration_s": 1.0})
    with pytest.raises(AttributeError, match="a Log has no") as refused:
        getattr(log, name)
    assert MEMBERS[name] in str(refused.value)
    assert not hasattr(log, name)
    assert not hasattr(log, "__array__")


def test_iterates_over_paths_and_completes_them():
    log = small()
    assert list(log) == list(log.paths) == log._ipython_key_completions_()


@pytest.mark.parametrize("index", [0, slice(0, 3), ["truth.heading"]])
def test_rejects_an_index_that_is_not_a_path(index):
    with pytest.raises(InputError, match="is read by its path") as refused:
        small()[index]
    assert "log.between(t0, t1)" in refused.value.fix


@pytest.mark.parametrize("name", ["t", "time"])
def test_time_index_error_suggests_the_t_attribute(name):
    with pytest.raises(InputError, match="not in this log") as refused:
        small()[name]
    assert "log.t" in refused.value.fix


def test_check_log_rejects_other_objects():
    check_log(small(), "plot_run({})")
    for value, fix in (
        ("hovercraft/spin", "simulate('hovercraft/spin')"),
        ("a.mcap", "read_log('a.mcap')"),
        (3, "read"),
    ):
        with pytest.raises(InputError, match="is not a log") as refused:
            check_log(value, "plot_run({})")
        assert fix in refused.value.fix

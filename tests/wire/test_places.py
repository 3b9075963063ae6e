import numpy as np
import pytest

from trimtab.core.errors import InputError
from trimtab.core.record import leaves
from trimtab.wire.places import MessagePlaces


@pytest.fixture
def places(dialect):
    """A vector with every path of the dialect in an order of its own, with room between."""
    sizes = {}
    for own in dialect.places.values():
        for path, slot, _ in own:
            sizes[path] = max(sizes.get(path, 0), slot + 1)
    found, k = {}, 3
    for path in sorted(sizes, reverse=True):
        found[path] = k if sizes[path] == 1 else slice(k, k + sizes[path])
        k += sizes[path] + 2
    return found, k


def test_a_vector_goes_over_the_wire_whole(dialect, open_pair, places):
    where, size = places
    both = MessagePlaces(dialect, where)
    assert set(both.groups) == set(dialect.groups)
    rng = np.random.default_rng(1)
    sent, got = rng.integers(1, 100, size).astype(float), np.zeros(size)
    a, b = open_pair
    complete = []
    for group in both.groups:
        for name, values in both.read_messages(group, sent):
            complete += [both.write_message(m, got) for m in b.feed(a.pack(name, values))]
    assert sorted(filter(None, complete)) == sorted(dialect.groups)
    used = np.zeros(size, bool)
    for at in where.values():
        used[at] = True
    np.testing.assert_array_equal(got[used], sent[used])
    assert not got[~used].any()
    assert a.counts.clamped == 0


def test_parts_of_different_times_are_never_mixed(dialect, open_pair, places):
    where, size = places
    both = MessagePlaces(dialect, where, ["samples.double-wide"])
    a, b = open_pair
    old, new, got = np.full(size, 1.0), np.full(size, 2.0), np.zeros(size)

    def send(vector, parts):
        packed = [a.pack(*both.read_messages("samples.double-wide", vector)[k]) for k in parts]
        return [both.write_message(m, got) for m in b.feed(b"".join(packed))]

    assert send(old, (0, 1)) == [None, None]
    assert send(new, (2, 1)) == [None, None]
    assert not got.any()
    assert send(new, (0,)) == ["samples.double-wide"]
    assert set(got) == {0.0, 2.0}


def test_what_is_not_finite_is_put_right_where_a_whole_number_belongs(dialect, open_pair, places):
    where, size = places
    a, _ = open_pair
    vector = np.full(size, np.nan)
    ((name, values),) = MessagePlaces(dialect, where).read_messages("command", vector)
    a.pack(name, values)
    assert a.counts.clamped == 1


def test_messages_without_a_place_are_let_by(dialect, open_pair, places):
    where, size = places
    a, b = open_pair
    both = MessagePlaces(dialect, where, ["command"])
    (message,) = b.feed(a.pack("SAMPLE_EVERY", {"t": 5}))
    assert both.write_message(message, np.zeros(size)) is None


def test_a_group_without_all_its_places_is_refused(dialect, places):
    where, _ = places
    with pytest.raises(InputError, match=r"command\.t"):
        MessagePlaces(dialect, {k: v for k, v in where.items() if k != "command.t"}, ["command"])


def test_paths_are_those_of_the_records(dialect):
    from wire.line import every, sample

    paths = {f"samples.every.{path}" for path, _, _ in leaves(sample(every()))}
    own = {p.path for p in dialect.places["SAMPLE_EVERY"]}
    assert own == paths - {"samples.every.age", "samples.every.fresh"}

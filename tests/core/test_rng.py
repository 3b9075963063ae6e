"""Counter-based random numbers: known answers, jax's own threefry as oracle, statistics, and streams by name."""

import jax
import jax.extend.random
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from trimtab.core.rng import Key, key, normal2, normals, threefry2x32, uniform2


@pytest.mark.parametrize(
    ("k", "c", "words"),
    [
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((2**32 - 1, 2**32 - 1), (2**32 - 1, 2**32 - 1), (0x1CB996FC, 0xBB002BE7)),
        ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
        ((7, 0), (1, 3), (0x72ED89E7, 0x8A3447F5)),
    ],
)
def test_threefry_matches_known_answers(k, c, words):
    """The first three are the 20-round known answers of Salmon et al.'s Random123 distribution."""
    got = threefry2x32(*(np.uint32(w) for w in (*k, *c)))
    assert tuple(int(w) for w in got) == words


def _plain_threefry(k0, k1, c0, c1):
    """Threefry 2x32, 20 rounds, with Python's own integers and one rotation table."""
    mask, keys = 2**32 - 1, (k0, k1, k0 ^ k1 ^ 0x1BD11BDA)
    x, y = (c0 + k0) & mask, (c1 + k1) & mask
    for i in range(20):
        r = (13, 15, 26, 6, 17, 29, 16, 24)[i % 8]
        x = (x + y) & mask
        y = (((y << r) | (y >> (32 - r))) & mask) ^ x
        if i % 4 == 3:
            s = i // 4 + 1
            x, y = (x + keys[s % 3]) & mask, (y + keys[(s + 1) % 3] + s) & mask
    return x, y


def test_threefry_matches_plain_python_and_jax():
    rng = np.random.default_rng(1)
    k = rng.integers(0, 2**32, 2, dtype=np.uint32)
    c = rng.integers(0, 2**32, (2, 200), dtype=np.uint32)
    a, b = (np.asarray(w) for w in threefry2x32(k[0], k[1], c[0], c[1]))
    for i in range(200):
        assert (int(a[i]), int(b[i])) == _plain_threefry(int(k[0]), int(k[1]), int(c[0, i]), int(c[1, i]))
    theirs = np.asarray(jax.extend.random.threefry_2x32(jnp.asarray(k), jnp.asarray(c.reshape(-1))))
    np.testing.assert_array_equal(np.concatenate([a, b]), theirs)


def test_uniforms_are_uniform_in_the_open_interval():
    k = key(3, 1)
    u, v = (np.asarray(w) for w in jax.jit(lambda i: uniform2(k, i))(jnp.arange(100_000)))
    for w in (u, v):
        assert w.min() > 0.0
        assert w.max() < 1.0
        assert stats.kstest(w, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(u, v)[0, 1]) < 4 / np.sqrt(len(u))


def test_extreme_words_give_finite_normals():
    """A word of all zeros or ones gives a finite normal: the interval is open."""
    from trimtab.core.rng import _uniform

    ends = np.asarray(_uniform(jnp.array([0, 2**32 - 1], np.uint32)))
    assert ends[0] == 2.0**-33
    assert ends[1] == 1 - 2.0**-33
    assert np.isfinite(np.sqrt(-2 * np.log(ends))).all()


def test_normals_are_normal_and_independent():
    k = key(11, 2)
    z = np.asarray(jax.jit(jax.vmap(lambda i: normals(k, i, 4)))(jnp.arange(50_000)))
    assert z.shape == (50_000, 4)
    for column in z.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    off_diagonal = np.corrcoef(z.T) - np.eye(4)
    assert np.abs(off_diagonal).max() < 4.5 / np.sqrt(len(z))
    lagged = np.corrcoef(z[:-1, 0], z[1:, 0])[0, 1]
    assert abs(lagged) < 4 / np.sqrt(len(z))


def test_odd_count_of_normals_is_a_prefix_of_even():
    k = key(5)
    two, three, four, first = jax.jit(lambda i: (*(normals(k, i, n) for n in (2, 3, 4)), jnp.stack(normal2(k, i))))(9)
    np.testing.assert_array_equal(three, four[:3])
    np.testing.assert_array_equal(two, first)


def test_draw_depends_only_on_seed_run_index_and_stream():
    draws = {
        float(uniform2(k, i, s)[0])
        for k in (key(1, 0), key(1, 1), key(2, 0), key(1, 0).at("imu"))
        for i in (0, 1)
        for s in (0, 1)
    }
    assert len(draws) == 16
    assert uniform2(key(1, 0), 5, 1) == uniform2(key(1, 0), np.int64(5), 1)


def test_seed_and_run_wrap_modulo_32_bits():
    assert int(key(2**32 + 3, -1).seed) == 3
    assert int(key(0, -1).run) == 2**32 - 1


def test_stream_depends_only_on_the_path():
    root = key(1)
    names = ["sensors", "uplink", "downlink", "imu", "actuators"]
    streams = {root.at(n).stream for n in names} | {root.at("sensors").at(n).stream for n in names}
    assert len(streams) == 10
    assert root.at("sensors").at("imu").stream == key(99, 7).at("sensors").at("imu").stream
    assert root.at("a").at("b").stream != root.at("b").at("a").stream


def test_streams_of_different_blocks_are_uncorrelated():
    k = key(4)
    draw = jax.jit(lambda k: normals(k, jnp.arange(1), 64))
    a, b = (np.asarray(draw(k.at(n))).ravel() for n in ("uplink", "downlink"))
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.5
    assert not np.isin(a, b).any()


def test_batched_runs_equal_single_runs():
    runs = jnp.arange(5, dtype=jnp.uint32)
    batch = jax.vmap(lambda r: jnp.stack(uniform2(Key(np.uint32(7), r, 12), 3)))(runs)
    for r in range(5):
        np.testing.assert_array_equal(batch[r], jnp.stack(uniform2(Key(np.uint32(7), np.uint32(r), 12), 3)))


GROUPS = 32


def grouped(words, stream=5):
    return Key(np.uint32(1), jnp.asarray(words, np.uint32), stream)


@pytest.mark.thorough
def test_grouped_keys_draw_independent_normals():
    words = np.random.default_rng(3).integers(0, 2**32, GROUPS, dtype=np.uint32)
    z = np.asarray(jax.jit(jax.vmap(lambda i: normals(grouped(words), i, 4)))(jnp.arange(50_000)))
    for column in z.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(z.T) - np.eye(4)).max() < 4.5 / np.sqrt(len(z))
    lags = [np.corrcoef(z[:-lag, 0], z[lag:, 0])[0, 1] for lag in range(1, 2 * GROUPS)]
    assert np.abs(lags).max() < 5 / np.sqrt(len(z))
    u = np.asarray(jax.vmap(lambda i: jnp.stack(uniform2(grouped(words), i)))(jnp.arange(50_000)))
    assert all(stats.kstest(column, "uniform").pvalue > 1e-3 for column in u.T)
    np.testing.assert_array_equal(normals(grouped(words), 9, 2), jnp.stack(normal2(grouped(words), 9)))


@pytest.mark.thorough
def test_changing_one_group_word_changes_its_share_of_draws():
    """A normal is a sum of eight terms in eight groups: a quarter of them change, each by an eighth of its variance."""
    rng = np.random.default_rng(4)
    words = rng.integers(0, 2**32, GROUPS, dtype=np.uint32)
    other = words.copy()
    other[7] = rng.integers(0, 2**32, dtype=np.uint32)
    draw = jax.jit(jax.vmap(lambda k, i: normal2(grouped(k), i)[0], (None, 0)))
    index = jnp.arange(20_000)
    a, b = (np.asarray(draw(jnp.asarray(k), index)) for k in (words, other))
    moved = a != b
    assert moved.mean() == pytest.approx(8 / GROUPS, abs=1e-9)
    assert np.var((a - b)[moved]) == pytest.approx(2 / 8, rel=0.1)
    u = [np.asarray(jax.vmap(lambda i, k=k: uniform2(grouped(k), i)[0])(index)) for k in (words, other)]
    assert (u[0] != u[1]).mean() == pytest.approx(1 / GROUPS, abs=1e-9)

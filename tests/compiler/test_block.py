"""block_text: what the header promises, and states that are swapped, kept in memory, or empty."""

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.compiler.block import BlockDefinition, block_text
from trimtab.core.record import Scalar, quantity, record


@record
class Gain:
    """A gain. Source: none."""

    k: Scalar = quantity("1/s", "Gain.", default=2.0)


@record
class Ring:
    """Two numbers and a ring. Source: none."""

    a: Scalar = quantity("m", "One.")
    b: Scalar = quantity("m", "Other.")
    ring: Scalar = quantity("m", "Past.", shape=(60,))
    at: Scalar = quantity("1", "Where.", kind="count")


def made(step, real="f64"):
    zeros = Ring(a=0.0, b=1.0, ring=np.zeros(60), at=np.int32(0))
    block = BlockDefinition("block", "A block.", step, lambda p: zeros, Gain(np.float64(2.0)), np.float64(0.0))
    return block_text(block, real)


def bounded(p, s, u):
    old = s.ring[s.at]
    ring = s.ring.at[s.at].set(u)
    return Ring(a=s.b, b=s.a * p.k, ring=ring, at=(s.at + 1) % 60), {"old": old, "sum": s.a + s.b}


def test_swapped_states_and_rings_are_written_in_place():
    text = made(bounded).source
    body = text[text.index("void block_step") :]
    assert "s->ring[" in body
    assert "for (" not in body  # no copy of the ring
    assert body.index("out->old") > 0


def test_array_read_after_its_update_is_copied_first():
    def late(p, s, u):
        ring = s.ring.at[s.at].set(u)
        return Ring(a=s.b, b=s.a, ring=ring, at=s.at), s.ring[s.at]

    assert "for (" in made(late).source


def test_header_states_whether_loops_are_bounded():
    assert "every loop is bounded" in made(bounded).header

    def until(p, s, u):
        return s, jax.lax.while_loop(lambda x: x < u, lambda x: x * p.k + 1.0, jnp.float64(0.0))

    assert "the length of some loops depends on data" in made(until).header


def test_header_members_have_unit_meaning_and_type():
    header = made(bounded, "f32").header
    assert "float k;  /* 1/s: Gain. */" in header
    assert "float ring[60];  /* m: Past. */" in header
    assert "int32_t at;  /* Where. */" in header
    assert "typedef float block_real;" in header

"""Heading from the positions of two units of one vehicle.

The units can't be located at the same time: one is polled, and a slot later the other. What the vehicle moved in
between counts as heading error, unless inertial navigation says how much it was.

[1] is Z. Kulis, "Feedback control of a hovercraft over a wireless link", University of Maryland, 2006.
"""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.core.rotation import wrap


def two_unit_heading(place_a: Any, place_b: Any, lever_a: Any, lever_b: Any) -> Any:
    """Heading (rad, in [-pi, pi)) that turns the line from unit b to unit a, as it is in B, into the one in W.

    Args:
        place_a: north, east of unit a (m), shape (2,).
        place_b: of unit b, at the same time.
        lever_a: x, y of unit a in B (m), shape (2,); on the body's x axis in the source.
        lever_b: of unit b.

    Source: [1] section 5.4.
    """
    W, B = place_a - place_b, lever_a - lever_b
    return wrap(jnp.arctan2(W[1], W[0]) - jnp.arctan2(B[1], B[0]))


def assisted_heading(place_a: Any, place_b: Any, moved: Any, lever_a: Any, lever_b: Any) -> Any:
    """The same from unit a's position at t_a and unit b's at t_b, with what unit a moved in between.

        r_a' = r_a + [r_ins(t_b) - r_ins(t_a)]

    Args: as `two_unit_heading`; moved: the bracket, north and east (m), shape (2,). It is exact where the inertial
    navigation's position is that of unit a; that of another point of the vehicle leaves out what the turn moves a.

    Source: [1] section 5.4.
    """
    return two_unit_heading(place_a + moved, place_b, lever_a, lever_b)


def heading_error(position_error: Any, lever_a: Any, lever_b: Any) -> Any:
    """Standard deviation of the heading (rad) from that of each unit's position, per axis (m): sqrt(2) sigma / base."""
    B = lever_a - lever_b
    return jnp.sqrt(2.0) * position_error / jnp.sqrt(B[0] ** 2 + B[1] ** 2)

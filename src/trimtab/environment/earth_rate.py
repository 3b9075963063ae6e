"""The turning of the earth in the local frame, and the Coriolis acceleration: what the plane's navigation leaves out.

On a lab floor both are small: 15 deg/h, and 0.15 mm/s² at 1 m/s; a gyro's bias is hundreds of times more. Where that is
not so, give `earth_rate(latitude)` to the inertial unit and to the navigation.

Source: Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections 2.4 and
5.4; the rate is that of NIMA TR8350.2, table 3.1.
"""

from typing import Any

from trimtab.core.float64 import jnp
from trimtab.environment.geodetic import curvature_radii
from trimtab.environment.gravity import RATE


def earth_rate(latitude: Any) -> Any:
    """Angular velocity of the earth (3,) (rad/s) in local north-east-down, at a geodetic latitude (rad)."""
    c, s = jnp.cos(latitude), jnp.sin(latitude)
    return jnp.stack([RATE * c, jnp.zeros_like(c), -RATE * s])


def coriolis(earth_rate_W: Any, v_W: Any) -> Any:
    """Coriolis acceleration -2 Omega × v (3,) (m/s²): what turns a free body aside, seen in the turning frame W."""
    return -2 * jnp.cross(earth_rate_W, v_W)


def transport_rate(latitude: Any, height: Any, v_W: Any) -> Any:
    """Rate (3,) (rad/s) at which local north-east-down turns as one travels over the ellipsoid at v_W (3,) (m/s).

    Zero for a fixed tangent plane, which does not follow the vehicle. Singular at the poles, where east is not defined.
    """
    meridian, normal = curvature_radii(latitude)
    east = v_W[1] / (normal + height)
    return jnp.stack([east, -v_W[0] / (meridian + height), -east * jnp.tan(latitude)])

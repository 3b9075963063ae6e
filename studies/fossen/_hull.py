"""Hull of REMUS: Myring's profile, and its hydrodynamic coefficients by slender-body theory. [1] chapters 2 and 4."""

from typing import Any

import numpy as np
from scipy.integrate import quad

RHO = 1030.0
A, A_OFFSET, B, C, C_OFFSET, N, THETA, D = 0.191, 0.0165, 0.654, 0.541, 0.0368, 2.0, 0.436, 0.191
"""Nose, nose offset, middle, tail, tail offset (m), exponent, tail angle (rad), diameter (m): [1] table 2.1."""
NOSE_END, BODY = A - A_OFFSET, A - A_OFFSET + B
LENGTH = BODY + C - C_OFFSET
NOSE = 0.611
"""Length of the nose ahead of the centre of buoyancy (m): [1] chapter 2."""
TAIL_START, FIN_END, FIN_START, NOSE_START = -0.721, -0.685, -0.611, 0.610
FIN_RADIUS = 0.131
FIN_AREA, FIN_POST = 6.65e-3, -0.638
"""Area of each fin (m^2), and its position (m): [1] table 2.2."""
CROSS_FLOW, FIN_DRAG = 1.1, 0.56
"""Drag of a cylinder and of a fin across the flow: [1] chapter 4."""


def radius(s: float) -> float:
    """Return the radius of the hull (m) at distance s (m) behind the nose. Both ends are blunt."""
    if s < NOSE_END:
        return D / 2 * (1 - ((s + A_OFFSET - A) / A) ** 2) ** (1 / N)
    if s < BODY:
        return D / 2
    t = s - BODY
    return D / 2 - (3 * D / (2 * C**2) - np.tan(THETA) / C) * t**2 + (D / C**3 - np.tan(THETA) / C**2) * t**3


def integrate(f: Any, start: float, end: float) -> float:
    """Integrate f(x, R(x)) over x, the distance (m) ahead of the centre of buoyancy. R is the hull's radius (m)."""
    corners = [x for x in (NOSE - NOSE_END, NOSE - BODY) if start < x < end]
    return float(quad(lambda x: f(x, radius(NOSE - x)), start, end, points=corners or None, limit=200)[0])


def volume() -> float:
    """Return the volume of the hull (m^3)."""
    return integrate(lambda x, R: np.pi * R**2, NOSE - LENGTH, NOSE)


def centroid() -> float:
    """Return the distance (m) of the hull's centroid ahead of the centre of buoyancy."""
    return integrate(lambda x, R: x * np.pi * R**2, NOSE - LENGTH, NOSE) / volume()


def projected_area() -> float:
    """Return the area of the hull seen from the side (m^2)."""
    return integrate(lambda x, R: 2 * R, NOSE - LENGTH, NOSE)


def added_mass(power: int) -> float:
    """Return the integral of x^power m_a(x) along the hull.

    m_a is the added mass per length of a circular cross-section, with fins where the hull has fins.
    """

    def bare(x: float, R: float) -> float:
        return x**power * np.pi * RHO * R**2

    def finned(x: float, R: float) -> float:
        return x**power * np.pi * RHO * (FIN_RADIUS**2 - R**2 + R**4 / FIN_RADIUS**2)

    return (
        integrate(bare, TAIL_START, FIN_END)
        + integrate(finned, FIN_END, FIN_START)
        + integrate(bare, FIN_START, NOSE_START)
    )


def axial_added_mass() -> float:
    """Return the axial added mass (kg) of an ellipsoid of the hull's length and diameter, by Lamb's factor."""
    e = np.sqrt(1 - (D / LENGTH) ** 2)
    alpha = 2 * (1 - e**2) / e**3 * (np.arctanh(e) - e)
    return alpha / (2 - alpha) * RHO * 4 / 3 * np.pi * LENGTH / 2 * (D / 2) ** 2


def cross_drag(weight: Any) -> float:
    """Return the integral of weight(x) times the cross-flow drag of hull and two fins.

    The unit is kg/m times the unit of weight(x).
    """
    hull = RHO * CROSS_FLOW / 2 * integrate(lambda x, R: 2 * R * weight(x), TAIL_START, NOSE_START)
    return hull + 2 * weight(FIN_POST) * RHO / 2 * FIN_AREA * FIN_DRAG

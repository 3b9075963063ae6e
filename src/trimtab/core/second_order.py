"""Second-order sections of digital filters: difference equations of sensor responses, which flight code inverts.

    y_k = b0 u_k + b1 u_{k-1} + b2 u_{k-2} - a1 y_{k-1} - a2 y_{k-2}

Values may have any shape; each component is filtered separately.
"""

from typing import Any

import jax.numpy as jnp

from trimtab.core.record import Scalar, quantity, record


@record
class Section:
    """Coefficients of one section. Source: Oppenheim, Schafer, "Discrete-time signal processing", section 6.3."""

    b0: Scalar = quantity("1", "Coefficient of the newest input.")
    b1: Scalar = quantity("1", "Coefficient of the previous input.", default=0.0)
    b2: Scalar = quantity("1", "Coefficient of the input two samples ago.", default=0.0)
    a1: Scalar = quantity("1", "Coefficient of the previous output.", default=0.0)
    a2: Scalar = quantity("1", "Coefficient of the output two samples ago.", default=0.0)

    def gain(self) -> Any:
        """Return the static gain: output divided by a constant input."""
        return (self.b0 + self.b1 + self.b2) / (1 + self.a1 + self.a2)


@record
class SectionState:
    """State of a section in transposed direct form II. Source: Oppenheim, Schafer, section 6.3."""

    s1: Any = quantity("1", "First delay element, in the unit of the signal.")
    s2: Any = quantity("1", "Second delay element, in the unit of the signal.")


def steady_state(section: Section, u: Any) -> SectionState:
    """Return the section's state after a constant input u for all time."""
    y = section.gain() * u
    s2 = section.b2 * u - section.a2 * y
    return SectionState(s1=section.b1 * u - section.a1 * y + s2, s2=s2)


def filter_sample(section: Section, state: SectionState, u: Any) -> tuple[SectionState, Any]:
    """Return the section's next state, and its output for the newest input u."""
    y = section.b0 * u + state.s1
    s1 = section.b1 * u - section.a1 * y + state.s2
    return SectionState(s1=s1, s2=section.b2 * u - section.a2 * y), y


def low_pass(frequency: Any, damping: Any, sampling_period: Any) -> Section:
    """Return the section for w²/(s² + 2 z w s + w²) by the bilinear transform, exact at the natural frequency.

    Args:
        frequency: natural frequency (Hz), below half the sampling rate. For z = 1/√2 it is the -3 dB bandwidth.
        damping: damping ratio z.
        sampling_period: time between samples (s).

    Source: Oppenheim, Schafer, "Discrete-time signal processing", section 7.1, with the frequency prewarped.
    """
    g = jnp.tan(jnp.pi * frequency * sampling_period)
    a0 = 1 + 2 * damping * g + g * g
    b = g * g / a0
    return Section(b0=b, b1=2 * b, b2=b, a1=2 * (g * g - 1) / a0, a2=(1 - 2 * damping * g + g * g) / a0)

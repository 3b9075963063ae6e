"""A sensor with a fault."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from trimtab.core.record import option, part, record, replace
from trimtab.core.rng import Key
from trimtab.core.signals import Motion, Sample
from trimtab.loop.fault import Fault
from trimtab.loop.faulty_samples import FaultySamples, apply_fault, initial_fault_memory


@record
class FaultySensorState:
    """State of the sensor, and what its fault remembers. Frames: theirs. Source: docs page, Faults."""

    inner: Any = part("State of the sensor.")
    samples: FaultySamples = part("What the fault remembers.")


@record
class FaultySensor:
    """A sensor whose samples are spoilt while a fault acts; before and after it is the sensor itself, bit for bit.

    The fault may watch what the sensor feels, e.g. `p_WB.0` or `v_WB_B.1` of a motion.

    Frames:  the sensor's.    Source:  docs page, Faults.
    """

    inner: Any = part("The sensor.")
    fault: Fault = part("What goes wrong.", default=Fault())
    felt: Any = part("What it feels, of any numbers, where that is not a motion.", default=None)
    capacity: int = option("How many samples a delay may lie back, and one.", default=2)

    @property
    def period(self) -> int:
        """The sensor's."""
        return self.inner.period

    @property
    def FEELS(self) -> str:
        """The sensor's."""
        return getattr(self.inner, "FEELS", "motion")

    def check(self) -> None:
        """Refuse a delay that can't be held."""
        self.fault.check_ring(self.period, self.capacity)

    def init(self, key: Key) -> FaultySensorState:
        """Nothing measured."""
        inner = self.inner.init(key)
        felt = _zero_motion() if self.felt is None else self.felt
        sample = jax.eval_shape(lambda s, x: self.inner.step(np.int64(0), s, x)[1], inner, felt)
        return FaultySensorState(inner=inner, samples=initial_fault_memory(key.at("fault"), sample, self.capacity))

    def measure(self, motion: Any) -> Any:
        """The sensor's, without noise or fault."""
        return self.inner.measure(motion)

    def step(self, t: Any, state: FaultySensorState, motion: Any) -> tuple[FaultySensorState, Sample]:
        """One sample at integer time t."""
        inner, sample = self.inner.step(t, state.inner, motion)
        samples, out = apply_fault(t, state.samples, self.fault, sample, motion, step=self.period, checked=False)
        return replace(state, inner=inner, samples=samples), out


def _zero_motion() -> Motion:
    three = jnp.zeros(3)
    return Motion(np.int64(0), three, three, three, three, three, three)

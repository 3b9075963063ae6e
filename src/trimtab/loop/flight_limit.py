"""A limit of the flight: part of a geofence, or of a speed envelope."""

from typing import Any

import jax.numpy as jnp

from trimtab.core.errors import InputError
from trimtab.core.record import Scalar, option, quantity, record


@record
class Limit:
    """A number of the estimate, or the length of a vector of them, that has to stay between two bounds.

        low <= x <= high    of one field;    low <= sqrt(x^2 + y^2 + …) <= high    of several

    What is not a number is outside.

    Frames:  the estimate's.    Source:  docs page, Supervisor.
    """

    fields: tuple[str, ...] = option("Fields of the estimated state, e.g. ('north',) or ('north', 'east').")
    low: Scalar = quantity("1", "Least value, in the field's unit.", default=-1e9)
    high: Scalar = quantity("1", "Greatest value, in the field's unit.", default=1e9)
    kind: str = option("What it belongs to.", default="geofence", choices=("geofence", "envelope"))

    def check(self) -> None:
        """Refuse bounds between which nothing lies."""
        if not self.fields:
            raise InputError("fields", "names no field of the estimate", fix="write e.g. fields=('north', 'east')")
        if not float(self.low) < float(self.high):
            problem = f"low, {float(self.low):g}, is not below high, {float(self.high):g}"
            raise InputError("low", problem, fix="exchange them")

    def breached(self, state: Any) -> Any:
        """Whether a state is outside."""
        numbers = [jnp.asarray(getattr(state, name)) for name in self.fields]
        x = numbers[0] if len(numbers) == 1 else jnp.sqrt(sum(n * n for n in numbers))
        return ~((self.low <= x) & (x <= self.high))

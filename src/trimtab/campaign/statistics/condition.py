"""What a run must do to be a success: a metric against a number, e.g. ``settling:yaw_rate <= 10``."""

import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from trimtab.core.errors import InputError

COMPARE: Mapping[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
}


class Condition(NamedTuple):
    """A metric, how it is compared, and with what."""

    metric: str
    compare: str
    bound: float

    def holds(self, column: Any) -> Any:
        """Whether it holds in each run (n,); never where the metric is no number."""
        with np.errstate(invalid="ignore"):
            return COMPARE[self.compare](column, self.bound)


def parse_condition(text: str) -> Condition:
    """A condition from its text."""
    found = re.fullmatch(r"\s*(.+?)\s*(<=|>=|<|>)\s*(\S+)\s*", text)
    try:
        if found:
            return Condition(found[1], found[2], float(found[3]))
    except ValueError:
        pass
    problem = f"{text!r} is not METRIC, a comparison and a number"
    raise InputError("--success", problem, choices=COMPARE, fix="--success 'settling:yaw_rate <= 10'")

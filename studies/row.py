"""A row of a study: what a publication gives, what this package computes, and the verdict."""

import dataclasses
import math
from typing import Any, Literal

Relation = Literal["within", "at most", "band", "inside", "overlaps", "direction", "same", "none"]
Basis = Literal["printed", "text", "axis", "reference"]
Verdict = Literal["holds", "differs", "not reproduced"]

INFINITY = math.inf


@dataclasses.dataclass(frozen=True)
class Row:
    """One figure of a publication beside the same figure computed here. Build it with a function of this module.

    id: unique in its study, ``place/what``.
    what: the figure in a few words.
    printed: number, pair (low, high) or words of the publication.
    computed: number, pair, word or truth value; None where nothing here can give it.
    citation: where it stands in the publication.
    relation: how the two are compared.
    accepted: (low, high) of what is accepted; infinite on an open side.
    unit: of printed, computed and accepted.
    basis: "printed", a number of the publication; "text", a statement of it; "axis", read off the axis of a plot;
        "reference", in no table: it follows from printed numbers by a calculation that is independent of this package.
    must_hold: whether the study fails without it.
    note: what to know of it; of a row that need not hold, the reason.
    """

    id: str
    what: str
    printed: Any
    computed: Any
    citation: str
    relation: Relation
    accepted: tuple[float, float] = (-INFINITY, INFINITY)
    unit: str = "1"
    basis: Basis = "printed"
    must_hold: bool = True
    note: str = ""

    def __post_init__(self) -> None:
        """Refuse a row without a citation, and one that may fail without a reason."""
        if not (self.id and self.what and self.citation):
            raise ValueError(f"row {self.id!r} lacks its id, its words or its citation")
        if not self.must_hold and not self.note:
            raise ValueError(f"row {self.id!r} need not hold: say why in its note")

    @property
    def holds(self) -> bool:
        """Whether computed is what is accepted; what is not a number is not."""
        low, high = self.accepted
        if self.computed is None:
            return False
        if self.relation == "same":
            return self.computed == self.printed
        if self.relation == "inside":
            return low <= self.computed[0] and self.computed[1] <= high
        if self.relation == "overlaps":
            return low <= self.computed[1] and self.computed[0] <= high
        if self.relation == "direction":
            return low < self.computed < high
        return low <= self.computed <= high

    @property
    def verdict(self) -> Verdict:
        """What is shown: a row that need not hold, and doesn't, is "not reproduced"."""
        return "holds" if self.holds else "differs" if self.must_hold else "not reproduced"

    @property
    def fails(self) -> bool:
        """Whether the study fails for it."""
        return self.must_hold and not self.holds

    @property
    def tolerance(self) -> str:
        """What is accepted, in words."""
        low, high = self.accepted
        if self.relation == "none":
            return ""
        if self.relation == "same":
            return "exact"
        if self.relation == "within":
            return f"± {high - self.printed:.3g}"
        if self.relation == "direction" and INFINITY in (-low, high):
            return f"> {low:g}" if high == INFINITY else f"< {high:g}"
        if self.relation == "at most":
            return f"≤ {high:g}"
        word = {"inside": "in ", "overlaps": "meets "}.get(self.relation, "")
        return f"{word}{low:g} … {high:g}"

    def as_json(self) -> dict[str, Any]:
        """The row as plain values; what is infinite or not a number becomes null."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return _replace_infinite(fields | {"tolerance": self.tolerance, "verdict": self.verdict})


def within(
    id: str,
    what: str,
    printed: float,
    computed: Any,
    citation: str,
    *,
    tolerance: float = 0.0,
    relative: float = 0.0,
    **about: Any,
) -> Row:
    """Computed is the printed number up to `tolerance` (in its unit) and `relative` (a part of it) together."""
    off = tolerance + relative * abs(printed)
    accepted = printed - off, printed + off
    return Row(id, what, printed, float(computed), citation, "within", accepted, **about)


def band(
    id: str, what: str, printed: Any, computed: Any, citation: str, *, low: float, high: float, **about: Any
) -> Row:
    """Computed lies in a band around what is printed, of which the publication says "about"."""
    return Row(id, what, printed, float(computed), citation, "band", (low, high), **about)


def at_most(id: str, what: str, printed: Any, computed: Any, citation: str, *, high: float, **about: Any) -> Row:
    """Computed is no more than `high`."""
    return Row(id, what, printed, float(computed), citation, "at most", (-INFINITY, high), **about)


def inside(id: str, what: str, axis: tuple[float, float], computed: Any, citation: str, **about: Any) -> Row:
    """The least and greatest value of a run lie inside the ends of a plot's axis."""
    pair = float(computed[0]), float(computed[1])
    return Row(id, what, axis, pair, citation, "inside", axis, **{"basis": "axis", **about})


def overlaps(id: str, what: str, interval: tuple[float, float], computed: Any, citation: str, **about: Any) -> Row:
    """The range of an extreme over many runs meets the band in which the axis of a plot says that it lay."""
    pair = float(computed[0]), float(computed[1])
    return Row(id, what, interval, pair, citation, "overlaps", interval, **{"basis": "axis", **about})


def direction(
    id: str,
    what: str,
    printed: str,
    computed: Any,
    citation: str,
    *,
    above: float = -INFINITY,
    below: float = INFINITY,
    **about: Any,
) -> Row:
    """A statement of the text, such as "slower", holds: computed lies on the side that it says."""
    return Row(id, what, printed, float(computed), citation, "direction", (above, below), **{"basis": "text", **about})


def same(id: str, what: str, printed: Any, computed: Any, citation: str, **about: Any) -> Row:
    """Computed is what is printed, exactly: counts, shapes, verdicts."""
    return Row(id, what, printed, computed, citation, "same", **about)


def missing_row(id: str, what: str, printed: Any, citation: str, *, note: str, **about: Any) -> Row:
    """Nothing here can give this figure; the note says why."""
    return Row(id, what, printed, None, citation, "none", must_hold=False, note=note, **about)


def format_value(value: Any) -> str:
    """A value as it stands in a table: four figures of a number, a pair as a range, - for none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, tuple) and all(isinstance(v, int) for v in value):
        return " x ".join(map(str, value))
    if isinstance(value, tuple):
        return " … ".join(format_value(v) for v in value)
    return str(value)


def _replace_infinite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _replace_infinite(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return [_replace_infinite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

"""What one line of the study is worth: right, wrong, unknown or nothing; said as sure, or only as a likeness."""

from __future__ import annotations

from seatrial.mocks.hidden_effects.catalogue import EFFECTS, OUTSIDE, make_effect
from tests.recovery.cases import Row
from tests.recovery.kinds import KINDS, NONE

UNKNOWN = "unknown"


def truths(row: Row) -> list[str]:
    """What the boat had, one effect, two or none."""
    return [] if row["effect"] == NONE else str(row["effect"]).split("+")


def first_answer(row: Row) -> str:
    """The effect named first; ``none``, or ``unknown`` for a drawn shape."""
    if not row["found"]:
        return NONE
    return UNKNOWN if row["found"][0].startswith("unknown ") else str(row["found"][0])


def answers(row: Row) -> list[str]:
    """The right answers: names, and ``unknown F(v)`` for what no catalogue lists."""
    return [_table(name, row["seed"]) if name in OUTSIDE else name for name in truths(row)]


def _table(name: str, seed: int) -> str:
    right = make_effect(name, seed).answer
    assert right is not None
    return f"unknown {right.force}({right.variable})"


def first_right(row: Row) -> bool:
    """The truth stands first, as sure; of a boat that lacks nothing, nothing is said."""
    if not truths(row):
        return not row["found"]
    if not row["found"]:
        return False
    return row["found"][0] in answers(row) and row["attribution"][0] in ("identified", "nonparametric")


def exactly(row: Row) -> bool:
    """The truth as sure, and nothing else: no further name, no table of what is left."""
    return first_right(row) and len(row["found"]) == len(truths(row))


def leads(row: Row) -> bool:
    """The truth stands first, as sure or as a likeness."""
    return bool(row["found"]) and row["found"][0] in truths(row)


def all_right(row: Row) -> bool:
    """Every truth is among what was named, likened or drawn; of a boat that lacks nothing, nothing is said."""
    if not truths(row):
        return not row["found"]
    return set(answers(row)) <= set(row["found"])


def wrong_as_sure(row: Row) -> bool:
    """Something that the boat has not is named as sure, first."""
    return bool(row["found"]) and row["attribution"][0] == "identified" and row["found"][0] not in truths(row)


def likened(row: Row) -> bool:
    """The first answer is a likeness: several effects that the data do not tell apart."""
    return bool(row["found"]) and row["attribution"][0] == "ambiguous"


def extra(row: Row) -> int:
    """Names said as sure of what is not there, not even at the 5 % of a mixture."""
    sure = [n for n, c in zip(row["found"], row["attribution"], strict=True) if c == "identified"]
    there = {*truths(row), *(EFFECTS if KINDS[row["kind"]].others else ())}
    return sum(n not in there for n in sure)


def drawn_right(row: Row) -> bool:
    """Of an effect outside the catalogue: the right force is drawn over the right variable, and no name is given as
    sure; it may be said to resemble one."""
    right = [a.removeprefix("unknown ") for a in answers(row) if a.startswith("unknown ")]
    return set(right) <= set(row.get("nonparametric_effects", [])) and not wrong_as_sure(row)

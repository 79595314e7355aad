"""Verdict on one line of the study: right, wrong, nonparametric or nothing; identified or only ambiguous."""

from __future__ import annotations

from seatrial.mocks.hidden_effects.catalogue import EFFECTS, OUTSIDE, make_effect
from seatrial.mocks.hidden_effects.realistic import IMPERFECTIONS
from tests.recovery.cases import Row
from tests.recovery.kinds import KINDS, NONE

UNKNOWN = "nonparametric"


def truths(row: Row) -> list[str]:
    """Return the true effects of the boat: none, one or two."""
    return [] if row["effect"] == NONE else str(row["effect"]).split("+")


def first_answer(row: Row) -> str:
    """Return the effect named first; ``none``, or ``nonparametric`` for a nonparametric effect."""
    if not row["found"]:
        return NONE
    return UNKNOWN if row["found"][0].startswith("unknown ") else str(row["found"][0])


def answers(row: Row) -> list[str]:
    """Return the right answers: names, and ``unknown F(v)`` for effects outside the catalogue."""
    return [_table(name, row["seed"]) if name in OUTSIDE else name for name in truths(row)]


def _table(name: str, seed: int) -> str:
    right = make_effect(name, seed).answer
    assert right is not None
    return f"unknown {right.force}({right.variable})"


def present(row: Row) -> set[str]:
    """Return the names of all effects of the boat, the small ones included."""
    how = KINDS[row["kind"]]
    small = EFFECTS if how.others else IMPERFECTIONS if how.realistic else ()
    return {*truths(row), *small}


def first_right(row: Row) -> bool:
    """Return whether the true effect is first and identified, or no effect was found on a clean boat."""
    if not truths(row):
        return not row["found"]
    if not row["found"]:
        return False
    return row["found"][0] in answers(row) and row["attribution"][0] in ("identified", "nonparametric")


def exactly(row: Row) -> bool:
    """Return whether the true effect is identified, and there is no other effect or nonparametric curve."""
    return first_right(row) and len(row["found"]) == len(truths(row))


def leads(row: Row) -> bool:
    """Return whether a true effect is first, with any attribution."""
    return bool(row["found"]) and row["found"][0] in truths(row)


def all_right(row: Row) -> bool:
    """Return whether all right answers were found, or no effect was found on a clean boat."""
    if not truths(row):
        return not row["found"]
    return set(answers(row)) <= set(row["found"])


def wrong_as_sure(row: Row) -> bool:
    """Return whether the first effect is identified but not in the boat."""
    if not row["found"] or row["attribution"][0] != "identified":
        return False
    known = present(row) if KINDS[row["kind"]].realistic else truths(row)
    return row["found"][0] not in known


def likened(row: Row) -> bool:
    """Return whether the first answer is ambiguous: the data do not distinguish several effects."""
    return bool(row["found"]) and row["attribution"][0] == "ambiguous"


def extra(row: Row) -> int:
    """Return the number of identified effects that the boat lacks, even at the 5 % size of a mixture."""
    sure = [n for n, c in zip(row["found"], row["attribution"], strict=True) if c == "identified"]
    return sum(n not in present(row) for n in sure)


def identified(row: Row) -> bool:
    """Return whether the true effect is identified, first or beside a small effect of a realistic boat."""
    return any(
        n in answers(row) and c in ("identified", "nonparametric")
        for n, c in zip(row["found"], row["attribution"], strict=True)
    )


def identified_or_first(row: Row) -> bool:
    """Return whether the true effect is identified, or first in the answer."""
    return identified(row) or row["found"][:1] == answers(row)[:1]


def falsely_sure(row: Row) -> bool:
    """Return whether an effect that the boat does not have is identified, first or not."""
    return extra(row) > 0


def drawn_right(row: Row) -> bool:
    """Return whether the right forces are drawn over the right variables and the first effect is not wrongly
    identified.

    This is for effects outside the catalogue.
    """
    right = [a.removeprefix("unknown ") for a in answers(row) if a.startswith("unknown ")]
    return set(right) <= set(row.get("nonparametric_effects", [])) and not wrong_as_sure(row)

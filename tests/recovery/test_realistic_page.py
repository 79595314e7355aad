"""Tests of the page of realistic mock boats: it is made of its data, and its counts are right."""

from __future__ import annotations

from typing import Any

from seatrial.ident.diagnosis.certainty import NAME_RECORDS, NameRecord
from tests.measured.real_boats import OUT as OF_OTHERS
from tests.measured.real_boats import named
from tests.recovery.realistic_page import DATA, PAGE, attribution_of, certainty, document
from tests.recovery.resumable import read


def row(effect: str, found: list[str], attribution: list[str], dominance: float) -> dict[str, Any]:
    ratios = {"horizon": {"x": 1.0, "psi": 1.0}}
    return {
        "key": effect, "kind": "realistic", "effect": effect, "seed": 3, "found": found, "attribution": attribution,
        "dominance": dominance, "before": ratios, "after": {"horizon": {"x": 0.5, "psi": 0.5}},
        "z": {"m_u": 0.5, "m_v": -4.0}, "cpu": 61.0,
    }  # fmt: skip


def test_the_page_is_made_of_its_data() -> None:
    assert PAGE.read_text(encoding="utf-8") == document([r for r in read(DATA).values() if "error" not in r])


def test_counts_of_the_page() -> None:
    clean = row("none", ["wind", "mooring"], ["identified", "identified"], 1.0) | {"kind": "realistic-clean"}
    rows = [
        clean,
        row("mismatch", ["wind", "mismatch"], ["identified", "identified"], 1.6),
        row("yaw-bias", ["yaw-bias"], ["ambiguous"], 1.4),
        row("cg-offset", ["cubic-drag"], ["identified"], 1.0),
    ]
    assert [attribution_of(r) for r in rows[1:]] == ["identified", "ambiguous", ""]
    text = " ".join(document(rows).split())
    assert "identified on 1 of 3 boats, found but ambiguous on 1, and not found on 1." in text
    assert "2 of the effects raise the error by 30 % or more; 1 of these are identified" in text
    assert "and 2 are found." in text
    assert certainty(rows)[1][:4] == ["identified", "5", "3", "60 %"]
    assert certainty(rows)[2][:4] == ["ambiguous", "1", "1", "100 %"]
    assert "3 of 6 masses and inertias are within three standard errors." in text
    assert "On 1 boats with the small imperfections alone, 2 effects are called identified (mooring, wind)" in text
    assert "of which 1 are not in the boat (95 % interval of such boats: " in text
    assert "2 of the identified names are wind, which is in every boat. Of the 3 others, 1 are right." in text
    assert "| 0.50 |" in document(rows)


def test_stated_probabilities_equal_the_study() -> None:
    table = certainty([r for r in read(DATA).values() if "error" not in r and r["kind"].startswith("realistic")])
    others = [*read(OF_OTHERS).values()]
    for how, n, right, *_ in table[1:]:
        n_others, right_others = named(others, how)
        record = NAME_RECORDS[how]
        assert (record.named, record.right) == (int(n) + n_others, int(right) + right_others)


def test_a_probability_belongs_to_the_next_name() -> None:
    assert NameRecord(59, 59).probability == 60 / 61
    assert NameRecord(0, 0).probability == 0.5

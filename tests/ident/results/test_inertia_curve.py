"""Tests of the note on a curve that has the form of an inertial force."""

from __future__ import annotations

from dataclasses import replace

import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.model.structure import ForceCurve
from seatrial.ident.results.diagnosis import inertia_curve_notes


@pytest.mark.parametrize(
    ("curve", "product"),
    [
        (ForceCurve("X", "v", "r"), "m_v v r"),
        (ForceCurve("X", "r", "v"), "m_v v r"),
        (ForceCurve("Y", "u", "r"), "m_u u r"),
        (ForceCurve("N", "u", "v"), "(m_u - m_v) u v"),
        (ForceCurve("N", "psi"), None),
        (ForceCurve("X", "u", "r"), None),
        (None, None),
    ],
)
def test_curve_over_a_product_of_the_inertia_has_a_note(curve: ForceCurve | None, product: str | None) -> None:
    effect = replace(catalogue()["wind"], curve=curve)
    notes = inertia_curve_notes([effect])
    assert len(notes) == (product is not None)
    assert product is None or f"the form of the inertial force {product} of a turning boat" in notes[0]

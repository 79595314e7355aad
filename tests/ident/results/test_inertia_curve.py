"""Tests of the note on a curve that has the form of an inertial force."""

from __future__ import annotations

from dataclasses import replace

import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.model import EffectKind, ForceCurve
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.diagnosis import inertia_curve_notes
from seatrial.ident.results.tables import _beside_inertial_curve


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
    effect = replace(catalogue()["wind"], curve=curve, kind=EffectKind.NONPARAMETRIC)
    notes = inertia_curve_notes([effect])
    assert len(notes) == (product is not None)
    assert product is None or f"the form of the inertial force {product} of a turning boat" in notes[0]


def test_the_row_of_a_mass_beside_such_a_curve_says_so() -> None:
    effect = replace(catalogue()["wind"], curve=ForceCurve("X", "v", "r"), kind=EffectKind.NONPARAMETRIC)
    m_u, m_v = (horizontal_model().parameter(name) for name in ("m_u", "m_v"))
    (flag,) = _beside_inertial_curve(m_v, [effect])
    assert (flag.code, flag) == ("no mass", "the curve X(v, r) has the form of m_v v r: this is no physical mass")
    assert _beside_inertial_curve(m_u, [effect]) == []
    assert _beside_inertial_curve(replace(m_v, free=False), [effect]) == []

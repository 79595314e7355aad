"""Test of the note on a noise at its assumed bound: it names the noise, and how to test the names of the effects."""

from __future__ import annotations

from dataclasses import replace

import pytest

from seatrial.ident.model.parameter import INF
from seatrial.ident.model.structure import Model
from seatrial.ident.models.horizontal import horizontal_model
from seatrial.ident.results.diagnosis import assumed_noise_notes


def with_noise(value: float, bound: float, *, free: bool = True) -> Model:
    model = horizontal_model("shaft")
    noise = next(p for p in model.parameters if p.name == "e_psi")
    return model.replace_parameters(replace(noise, value=value, bounds=(bound, INF), free=free))


def test_noise_at_its_bound_has_a_note_with_a_larger_and_a_smaller_value() -> None:
    (note,) = assumed_noise_notes(with_noise(0.010000001, 0.01))
    assert note.startswith("The noise e_psi of psi is at its assumed bound, 0.01 rad, and the names of the effects can")
    assert "with --fix e_psi=0.005 and with --fix e_psi=0.02, and repeat the diagnosis of each" in note


@pytest.mark.parametrize("model", [with_noise(0.012, 0.01), with_noise(0.01, 0.01, free=False), with_noise(0.01, 0.0)])
def test_other_noise_has_no_note(model: Model) -> None:
    assert assumed_noise_notes(model) == []

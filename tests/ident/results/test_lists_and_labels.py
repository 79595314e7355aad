"""Tests of lists of titles in a sentence, and of the names of parameters with a value for each log."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from seatrial.ident.effects import catalogue
from seatrial.ident.model import Parameter
from seatrial.ident.results.diagnosis import _flag_notes, _joined_titles
from seatrial.ident.results.tables import common_errors_notes, listed


@pytest.mark.parametrize(
    ("items", "last", "text"),
    [
        (["wind"], "and", "wind"),
        (["wind", "lift"], "and", "wind and lift"),
        (["wind", "lift", "a bank"], "", "wind, lift, a bank"),
        (["damping (Y_r, N_v)", "lift"], "", "damping (Y_r, N_v), lift"),
        (["latency, by commands", "lift"], "", "latency, by commands; lift"),
        (["wind", "latency, by commands", "lift"], "and", "wind; latency, by commands; and lift"),
    ],
)
def test_items_with_commas_are_separated_by_semicolons(items: list[str], last: str, text: str) -> None:
    assert listed(items, last) == text


def test_titles_of_common_errors_are_separate_items() -> None:
    effects = [catalogue()[n] for n in ("gnss-latency-command", "gyro-scale", "lift")]
    found = cast("Any", SimpleNamespace(effects=effects, gains=None))
    (note,) = common_errors_notes(found, "the model")
    assert f": {'; '.join(e.title for e in effects)} (they were" in note
    assert "by commands; and" in _joined_titles([effects[0].title, effects[2].title]).replace("driven ", "")


def test_parameter_of_one_log_has_the_name_of_the_log_in_notes() -> None:
    """As in the table of the parameters."""
    shared, own = Parameter("d_u", 1.0), Parameter("V_x", 0.1, per_record=True, segment=1)
    flags = ((own.full_name, "at its bound"), ("d_u", "at its bound"), ("other", "vague"))
    fit = cast("Any", SimpleNamespace(parameters=(shared, own), records=("may_a", "may_b"), flags=flags))
    assert own.full_name == "V_x@1"
    assert _flag_notes(fit) == ["Parameters V_x@may_b, d_u: at its bound", "Parameter other: vague"]

"""Tests of the names of the data that judge a model: validation logs, or blocks of time without them."""

from __future__ import annotations

from seatrial.api.plots import prediction_figure
from seatrial.ident.results import parts
from seatrial.ident.results.data_names import data_name, of_judging_data
from tests.ident.pages import KINDS, loaded


def test_only_blocks_in_place_of_validation_logs_have_another_name() -> None:
    assert [data_name(role, True) for role in ("validation", "estimation")] == ["blocks of time", "estimation data"]
    assert [data_name(role, False) for role in ("validation", "estimation")] == ["validation data", "estimation data"]
    text = "The validation data decide"
    assert of_judging_data(text, False) is text
    assert of_judging_data(text, True) == "The blocks of time decide"
    assert of_judging_data((text, 1.0, None), True) == ("The blocks of time decide", 1.0, None)
    row = parts.ResultWarning(code="short", text=text)
    assert of_judging_data(row, True) == parts.ResultWarning(code="short", text="The blocks of time decide")
    other = parts.ResultWarning(code="short", text="no such data")
    assert of_judging_data(other, True) is other


def test_a_figure_names_the_blocks_of_time() -> None:
    content = KINDS["diagnosis"]()
    for in_blocks in (False, True):
        titles = str(prediction_figure(loaded(content | {"cross_validated": in_blocks}), ["r"]).layout)
        assert ("(blocks of time)" in titles, "(validation)" in titles) == (in_blocks, not in_blocks)

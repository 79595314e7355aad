"""Tests of the sentence about the worst outage: the fix that its error refers to."""

from __future__ import annotations

from dataclasses import replace

from seatrial.ident.navigation.outages import Ellipse, Outage
from seatrial.ident.workflows.navigate import navigation_answer

WORST = Outage(
    start=10.0, end=70.0, open=False, leading=False, withheld=True, north=0.0, east=0.0,
    at_end=Ellipse(4.0, 3.0, 0.0, 4.0), error=2.3, allowed=5.0, inside=True, widest=4.0, predicted=None, best=None,
)  # fmt: skip


def test_outage_that_never_ends_is_compared_with_its_last_fix() -> None:
    assert "; compared with the first fix after it, it was 2.3 m off" in navigation_answer([WORST], [])
    assert "; compared with the last withheld fix, it was 2.3 m off" in navigation_answer(
        [replace(WORST, open=True)], []
    )

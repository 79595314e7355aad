"""Tests of the sentence about the outages: their fixes, and which outage is meant."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from seatrial.ident.navigation.outages import Ellipse, Outage, gnss_outages
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


def test_most_uncertain_outage_and_the_one_that_was_farthest_off_are_named_apart() -> None:
    assert navigation_answer([WORST], []).startswith("1 GNSS outage, of 60 s: at its end the position may be 4.0 m off")
    far = replace(WORST, end=40.0, at_end=Ellipse(2.0, 1.0, 0.0, 2.0), error=3.5, allowed=2.5, inside=False)
    answer = navigation_answer([far, WORST], [])
    assert answer == (
        "2 GNSS outages; at the end of the most uncertain one, 60 s long, the position may be 4.0 m off (95 %); "
        "compared with the first fix after it, it was 2.3 m off. Farthest off was another one, 30 s long: 3.5 m, "
        "allowed 2.5 m. At 1 of 2 outages the fix is within the 95 % radius."
    )
    assert "Farthest" not in navigation_answer([replace(far, error=1.0), WORST], [])


def test_verdict_compares_the_error_with_the_allowed_radius_of_the_table() -> None:
    """The position is uncertain to the north; an error of 1.2 m to the east is beyond the ellipse, not the radius."""
    rows, covariance = 31, np.diag([1.0, 0.04])
    position, fixes = np.zeros((rows, 2)), np.zeros((rows, 2))
    fixes[-1] = (0.0, 1.2)
    used = np.ones(rows, dtype=bool)
    used[1:-1] = False
    done: Any = SimpleNamespace(
        t=np.arange(float(rows)), fixes=fixes, used=used, withheld=~used, fix_variance=np.array([0.0, 0.0]),
        predicted=None, best=None, position=lambda _: (position, np.tile(covariance, (rows, 1, 1))),
    )  # fmt: skip
    (outage,) = gnss_outages(done)
    assert outage.error == 1.2
    assert outage.allowed is not None
    assert 1.9 < outage.allowed < 2.1
    assert outage.inside is True
    fixes[-1] = (0.0, 2.2)
    assert gnss_outages(done)[0].inside is False

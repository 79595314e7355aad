"""Tests of times that jump by years. They are reported before any time grid is created."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.checks import invalidates_fit
from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.data import Channel


@pytest.mark.parametrize(
    ("jump", "words"), [(44.4 * 365.25 * 86400.0, "44.4 years, 9.8 s"), (2.5e5, "2.9 days, 9.8 s")]
)
def test_clock_that_was_set_during_the_log_is_a_fault(jump: float, words: str) -> None:
    t = 0.2 * np.arange(400)
    t[50:] += jump
    c = {name: Channel(t, np.random.default_rng(1).standard_normal(t.size)) for name in ("x", "y", "psi", "r")}
    (found,) = check_signals(c, {})
    assert (found.code, found.level) == ("times-jump", "fault")
    assert words in found.text
    assert invalidates_fit(found)


def test_pause_of_an_hour_is_not_a_fault() -> None:
    t = 0.2 * np.arange(400)
    t[50:] += 3600.0
    c = {name: Channel(t, np.random.default_rng(1).standard_normal(t.size)) for name in ("psi", "r")}
    assert "times-jump" not in [f.code for f in check_signals(c, {})]

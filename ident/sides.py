"""Does the boat turn the way its thrusters push? A check before any fit, by plain regression.

Yaw acceleration (from the smoothed yaw rate) on the difference of thrust: left pushing harder turns the bow to
starboard, which is positive in NED. A fit would absorb a swapped pair in a monstrous inertia and say nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ident.dataset import Channel
from ident.model import Model

Array = NDArray[np.float64]
RATE, SMOOTH, MAX_LAG = 10.0, 0.5, 1.5  # Hz, s, s


@dataclass(frozen=True)
class Sides:
    """Correlation of yaw rate with the thrust difference passed through a first-order lag, one a run, and verdict."""

    runs: tuple[str, ...]
    correlation: tuple[float, ...]
    significant: tuple[bool, ...]

    @property
    def swapped(self) -> bool:
        """Every run that says anything says that the boat turns against its thrust."""
        votes = [c for c, s in zip(self.correlation, self.significant, strict=True) if s]
        return bool(votes) and all(c < 0 for c in votes)

    @property
    def line(self) -> str:
        against = sum(c < 0 and s for c, s in zip(self.correlation, self.significant, strict=True))
        return (
            f"The boat turns against its thrust difference in {against} of {len(self.runs)} runs: left and right "
            "are swapped in the data, or the sign of one of them or of yaw is wrong. Fitted with the sides swapped."
        )


def check_sides(runs: Sequence[tuple[str, Mapping[str, Channel]]], time_constant: float = 1.0) -> Sides | None:
    """None where the runs have no yaw rate or no pair of thrusters."""
    found = [(name, c) for name, channels in runs if (c := _correlation(channels, time_constant)) is not None]
    if not found:
        return None
    names, values = zip(*found, strict=True)
    return Sides(names, tuple(r for r, _ in values), tuple(p < 1e-3 for _, p in values))


def _correlation(channels: Mapping[str, Channel], time_constant: float) -> tuple[float, float] | None:
    pair = next((p for p in (("f_left", "f_right"), ("n_left", "n_right")) if all(n in channels for n in p)), None)
    if pair is None or "r" not in channels:
        return None
    left, right, r = channels[pair[0]], channels[pair[1]], channels["r"]
    t = np.arange(max(c.t[0] for c in (left, right, r)), min(c.t[-1] for c in (left, right, r)), 1 / RATE)
    push = [np.interp(t, c.t, c.value) for c in (left, right)]
    if pair[0] == "n_left":
        push = [p * np.abs(p) for p in push]
    difference = push[0] - push[1]
    if t.size < 50 or difference.std() < 1e-9:
        return None
    a = np.exp(-1 / RATE / time_constant)
    lagged = np.zeros(t.size)
    for k in range(1, t.size):
        lagged[k] = a * lagged[k - 1] + (1 - a) * difference[k - 1]
    rate = np.interp(t, r.t, r.value)
    x, y = lagged - lagged.mean(), rate - rate.mean()
    correlation = float(x @ y / np.sqrt((x @ x) * (y @ y) + 1e-300))
    # neighbouring samples are not independent: count one every two time constants
    n = max(4.0, t.size / RATE / (2 * time_constant))
    z = abs(np.arctanh(np.clip(correlation, -0.999999, 0.999999))) * np.sqrt(n - 3)
    return correlation, float(2 * stats.norm.sf(z))


def swap(model: Model) -> Model:
    """The model with its thrusters on each other's side."""
    arms = {n: model.parameter(n) for n in ("y_left", "y_right")}
    return model.replace_parameters(
        replace(arms["y_left"], value=arms["y_right"].value), replace(arms["y_right"], value=arms["y_left"].value)
    )

"""Tests of the search for a peak in the spectrum of the innovations. Coloured noise has no peak."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from seatrial.ident.numerics.spectral_peak import spectral_peak

DT = 0.1
SURE = 1e-6


def coloured(kind: str, rng: np.random.Generator, n: int = 4000) -> np.ndarray:
    w = rng.standard_normal(n)
    red = np.asarray(lfilter([1.0], [1.0, -0.9], rng.standard_normal(n)))
    return {
        "white": w,
        "red": red,
        "blue": np.asarray(lfilter([1.0, -0.4], [1.0], w)),
        "white and red": w + 0.3 * red,
    }[kind]


def narrow(frequency: float, damping: float, sd: float, rng: np.random.Generator, n: int = 4000) -> np.ndarray:
    """Return a lightly damped mode driven by white noise."""
    omega = 2 * np.pi * frequency
    r = np.exp(-damping * omega * DT)
    x = np.asarray(lfilter([1.0], [1.0, -2 * r * np.cos(omega * DT), r * r], rng.standard_normal(n)))
    return sd * x / x.std()


@pytest.mark.parametrize("kind", ["white", "red", "blue", "white and red"])
def test_coloured_noise_alone_has_no_peak(kind: str) -> None:
    rng = np.random.default_rng(3)
    p = []
    for _ in range(60):
        peak = spectral_peak({"ax": coloured(kind, rng), "r": coloured("white", rng)}, DT)
        assert peak is not None
        p.append(peak.p)
    assert min(p) > SURE
    assert np.mean(np.array(p) < 0.01) < 0.15


@pytest.mark.parametrize("kind", ["white", "red", "white and red"])
@pytest.mark.parametrize("frequency", [0.3, 0.45, 1.2])
def test_peak_is_found_at_its_frequency(kind: str, frequency: float) -> None:
    rng = np.random.default_rng(4)
    noise = coloured(kind, rng)
    waves = noise + narrow(frequency, 0.08, 0.6 * float(noise.std()), rng)
    peak = spectral_peak({"r": coloured("white", rng), "ax": waves}, DT)
    assert peak is not None
    assert (peak.channel, peak.frequency) == ("ax", pytest.approx(frequency, abs=0.08))
    assert peak.p < SURE


def test_gaps_are_bridged_and_short_or_sparse_channels_are_omitted() -> None:
    rng = np.random.default_rng(5)
    e = coloured("white", rng) + narrow(0.5, 0.08, 0.8, rng)
    e[rng.uniform(size=e.size) < 0.1] = np.nan
    peak = spectral_peak({"ax": e}, DT)
    assert peak is not None
    assert peak.frequency == pytest.approx(0.5, abs=0.08)
    sparse = np.where(rng.uniform(size=e.size) < 0.3, 1.0, np.nan)
    assert spectral_peak({"x": sparse, "short": e[:300]}, DT) is None
    assert spectral_peak({}, DT) is None

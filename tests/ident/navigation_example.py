"""Example of a navigation result for pages: an imaginary boat on a round trip with two outages, from seeded numbers."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from seatrial.ident.results.commands import NavigationResult

STATES = (
    ("x", "m", "north", False),
    ("y", "m", "east", False),
    ("psi", "rad", "heading", True),
    ("u", "m/s", "surge through the water", False),
    ("b_X", "N", "unexplained X", False),
    ("V_x", "m/s", "current to the north", False),
)


def arrays(_kind: Any, value: Any) -> Any:
    """Convert a curve, which msgspec cannot convert."""
    return np.asarray(value, dtype=np.float64)


def navigation(seed: int = 4) -> NavigationResult:
    """Return a result with every key that ``seatrial.ident.workflows.navigate`` writes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 240.0, 0.1)
    angle = t / 20.0
    unexplained = np.convolve(rng.normal(size=t.size), np.ones(30) / 30, "same")
    values = {
        "x": 20.0 * np.sin(angle),
        "y": 20.0 * (1 - np.cos(angle)),
        "psi": angle,
        "u": np.full(t.size, 1.0),
        "b_X": unexplained,
        "V_x": 0.05 * (1 - np.exp(-t / 40)),
    }
    lost = ((t > 60) & (t < 90)) | (t > 228)
    sd = {n: (0.03 + 0.02 * lost) * np.ones(t.size) for n in values}
    measured = {n: values[n] + 0.15 * rng.normal(size=t.size) for n in ("x", "y")}
    measured["psi"] = np.mod(angle + np.pi, 2 * np.pi) - np.pi
    used = np.where(lost, 0.0, 1.0)
    ellipse = {"major": 1.4, "minor": 0.4, "azimuth": 0.7, "radius": 1.2}
    misses = {"rms": 0.31, "largest": 0.8, "inside": 0.94, "n": 150}
    outage = {
        "record": "lake",
        "start": 60.0,
        "end": 90.0,
        "duration": 30.0,
        "open": False,
        "leading": False,
        "withheld": True,
        "north": float(values["x"][900]),
        "east": float(values["y"][900]),
        "at_end": ellipse,
        "error": 0.9,
        "allowed": 1.3,
        "inside": True,
        "widest": 0.2,
        "predicted": misses,
        "best": misses | {"rms": 0.22},
    }
    tail = outage | {
        "start": 228.0,
        "end": 240.0,
        "duration": 12.0,
        "open": True,
        "withheld": False,
        "error": None,
        "allowed": None,
        "inside": None,
        "predicted": None,
        "best": None,
    }
    states = [
        {
            "name": n,
            "unit": unit,
            "meaning": meaning,
            "angle": turns,
            "value": values[n],
            "sd": sd[n],
            "measured": measured.get(n),
        }
        for n, unit, meaning, turns in STATES
    ]
    content = {
        "format": "seatrial-result 3",
        "kind": "navigation",
        "answer": "2 GNSS outages; at the end of the most uncertain one, 30 s long, the position may be 1.2 m off "
        "(95 %).",
        "created": "2026-02-03T04:05:06+00:00",
        "seatrial": "0.1.0",
        "command": "seatrial ident navigate model.toml lake.mcap --gnss-outage 60:90",
        "logs": [
            {
                "path": "lake.mcap",
                "sha256": "ab" * 32,
                "role": "navigated",
                "name": "lake",
                "duration": 240.0,
                "rig": "boat",
                "mission": None,
                "warnings": [],
            }
        ],
        "navigation": [
            {
                "record": "lake",
                "kind": "smoothed",
                "t": t,
                "states": states,
                "fixes": {"t": t, "x": measured["x"], "y": measured["y"], "used": used},
            }
        ],
        "outages": [outage, tail],
        "inputs": [{"record": "lake", "name": "n_left", "unit": "", "t": t, "value": np.where(t % 20 < 10, 0.4, 0.6)}],
        "notes": ["lake: the log lacks these sensors of the model, which are not used: ground_velocity."],
    }
    return msgspec.convert(content, NavigationResult, dec_hook=arrays)

"""Content for the pages of a check, a design and a study: a boat that never was, from seeded numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

AIMS = {"bias": (-0.15, 0.15), "ratio": (0.9, 1.1), "coverage": (0.93, 0.97)}
MADE = {"created": "2025-05-06T07:08:09Z", "seatrial": "0.1.0"}


def check() -> dict[str, Any]:
    """A rig whose sides are swapped, and a mission that is run dry: every key that the page may be given."""
    words = (
        ("fault", "sides", "left and right", "left and right are swapped: the boat turns against its thrust difference",
         "exchange the nodes in the rig or the plugs"),
        ("fault", "rate", "gnss", "2.5 Hz, expected 5", "the device's output rate, or rate_hz of the rig"),
        ("warning", "late", "gnss", "velocity comes 0.40 s after acceleration", "its filters or its time stamps"),
        ("ok", "rate", "ahrs", "50 Hz, expected 50", ""), ("ok", "delay", "left", "the shaft follows 0.35 s later", ""),
    )
    findings = [dict(zip(("level", "check", "where", "text", "advice"), row, strict=True)) for row in words]
    t = np.arange(0.0, 60.0, 2.0)
    n = np.column_stack([np.sign(np.sin(t / 5.0)) * 0.6, np.sign(np.cos(t / 7.0)) * 0.6])
    way = np.linspace(0.0, 3.0, 200)
    mission = {"name": "mixed, seed 1", "thrusters": ["left", "right"], "t": t.tolist(), "n": n.tolist(), "end": 60.0,
               "fence": 60.0, "x": (20 * np.sin(way)).tolist(), "y": (20 * (1 - np.cos(way))).tolist(),
               "radius": (2 * way).tolist(), "by": "the design, by model horizontal"}
    return MADE | {"subject": "boat.toml", "rig": {"name": "boat"}, "command": "seatrial check boat.toml --report x",
                   "findings": findings, "mission": mission, "logs": [checked_log()]}


def checked_log() -> dict[str, Any]:
    """Curves as `ident.checks.evidence.log_evidence` gives them."""
    rng, t = np.random.default_rng(8), np.arange(0.0, 48.0, 0.1)
    told = np.where(np.mod(t, 12.0) < 6.0, 0.3, -0.3)
    r = 0.2 * np.convolve(told, np.exp(-np.arange(0, 6, 0.1)), "full")[: t.size]
    noisy = r + 0.004 * rng.normal(size=t.size)
    push = {"title": "yaw rate", "unit": "rad/s", "t": t, "measured": noisy, "expected": -r}
    shaft = {"name": "left", "t": t, "n": np.roll(told, 3), "t_cmd": t[::60], "n_cmd": told[::60], "end": 48.0}
    pair = {"title": "yaw rate", "unit": "rad/s", "names": ["of the heading, over 1 s", "of the gyro"], "t": t,
            "one": r, "other": noisy}
    heading = np.mod(np.cumsum(r) * 0.1 + 3.0, 2 * np.pi) - np.pi
    signals = [{"channel": "psi", "unit": "rad", "t": t, "value": heading, "angle": True},
               {"channel": "ax", "unit": "m/s2", "t": t, "value": rng.normal(size=t.size), "angle": False}]
    late = 0.02 + 0.002 * rng.exponential(size=t.size - 1)
    pauses = [{"source": "ahrs", "t": t[1:], "value": late, "expected": 0.02},
              {"source": "tide", "t": t[1::50], "value": np.full(10, 5.0), "expected": None}]
    return {"name": "actuator-test", "duration": 48.0, "rig": "boat", "pauses": pauses, "shafts": [shaft],
            "push": [push], "sensors": [pair], "signals": signals}


def design() -> dict[str, Any]:
    """A designed mission: every key that `ident.workflows.design` writes, with fewer samples."""
    rng = np.random.default_rng(9)
    t = np.arange(0.0, 120.0, 0.5)
    levels = [np.repeat(rng.uniform(-1, 1, 12), 20) for _ in range(2)]
    way = np.linspace(0.0, 4.0, 200)
    track = {"t": np.linspace(0, 120, 200), "x": 15 * np.sin(way), "y": 15 * (1 - np.cos(way)), "radius": 2 * way,
             "inside": 0.97, "corner": (-25.0, -10.0), "area": (50.0, 45.0)}
    track["others"] = [np.column_stack([track["x"] + k, track["y"] - k]) for k in range(8)]
    names = (("m_u", "kg", 37.0, "surge mass"), ("d_v", "kg/s", 50.0, "linear sway damping"))
    parameters = [{"name": n, "unit": u, "value": v, "meaning": m, "before": np.nan, "after": 0.02 * v,
                   "form": 0.01 * v, "rival": 0.05 * v, "chosen": True} for n, u, v, m in names]
    samples = {n: rng.normal(size, 2.0, 1000) for n, size in (("design", 40.0), ("PRBS", 35.0), ("RGS", 33.0))}
    return MADE | {
        "kind": "design", "command": "seatrial mission design horizontal --out next.toml", "model": "horizontal",
        "criterion": "D", "chosen": ["m_u", "d_v"], "form": "prediction error", "value": 41.2, "evaluations": 20000,
        "parameters": parameters, "rival": "PRBS", "limited": True, "samples": samples, "share_won": 0.992,
        "rivals": [{"name": n, "value": v, "bandwidth": 0.2, "seeds": [v]} for n, v in (("PRBS", 36.0), ("RGS", 34.0))],
        "inputs": [{"name": n, "t": t, "value": v} for n, v in zip(("left", "right"), levels, strict=True)],
        "track": track, "answer": "After this mission of 120 s a fit should know m_u ±0.74 kg (2 %)",
    }


def study() -> dict[str, Any]:
    """Two studies; of the second one parameter surely misses and one may do so by chance."""
    fine = [_parameter("m_u", "kg", -0.04, 1.05, 0.942, ()), _parameter("d_u", "kg/s", 0.01, 0.98, 0.95, ())]
    poor = [_parameter("d_v", "kg/s", 0.04, 0.93, 0.89, ("coverage",)),
            _parameter("s_u", "m/s/sqrt(s)", -0.17, 1.02, 0.944, ("bias (chance?)",))]
    common = {"method": "PE", "estimator": "prediction error", "replicates": 500, "failed": 0, "unconverged": 1,
              "cpu_fit": 0.006, "cpu_simulation": 0.02}
    return MADE | {
        "kind": "study", "command": "seatrial ident study surge yaw", "seed": 1, "logs": [],
        "answer": "surge, 500 replicates: 2 of 2 parameters are as wanted. yaw: these do not hold: d_v (coverage).",
        "studies": [common | {"model": "surge", "about": "300 s, steps of thrust", "parameters": fine},
                    common | {"model": "yaw", "about": "300 s, steps of moment", "parameters": poor},
                    common | {"model": "none", "about": "nothing converged", "parameters": []}],
    }


def _parameter(name: str, unit: str, bias: float, ratio: float, coverage: float, misses: tuple[str, ...]) -> Any:
    return {
        "name": name, "unit": unit, "truth": 37.0, "n": 499, "at_bound": 0, "sd": 0.1, "bias": bias, "bias_error": 0.04,
        "ratio": ratio, "ratio_low": 0.9 * ratio, "ratio_high": 1.13 * ratio, "bound_ratio": ratio,
        "bound_ratio_low": 0.9 * ratio, "bound_ratio_high": 1.13 * ratio,
        "coverage": coverage, "coverage_low": coverage - 0.02, "coverage_high": coverage + 0.02, "misses": list(misses),
    }

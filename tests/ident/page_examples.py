"""Examples for the pages of a check, a design and a study: an imaginary boat, from seeded numbers."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from seatrial.daq.checks.check_report import CheckReport, DryRun, PredictedTrack
from seatrial.daq.checks.findings import Finding
from seatrial.ident.checks.log_checks import (
    CheckEvidence,
    SampleIntervals,
    SensorPair,
    ShaftTrace,
    SignalCurve,
    ThrustResponseCurve,
)
from seatrial.ident.results.commands import DesignResult, StudyResult
from tests.ident.navigation_example import arrays

AIMS = {"bias": (-0.15, 0.15), "ratio": (0.9, 1.1), "coverage": (0.93, 0.97)}
MADE = {"created": "2025-05-06T07:08:09Z", "seatrial": "0.1.0"}


def check() -> CheckReport:
    """Return the check of a rig with swapped sides and a mission that is simulated in advance. It fills every part of
    the page.
    """
    findings = (
        Finding(
            "fault",
            "thruster-sides-swapped",
            "sides",
            "left and right",
            "left and right are swapped: the boat turns against its thrust difference",
            "exchange the nodes in the rig or the plugs",
        ),
        Finding("fault", "rate-off", "rate", "gnss", "2.5 Hz, expected 5", "its output rate, or rate_hz of the rig"),
        Finding(
            "warning",
            "sensor-late",
            "late",
            "gnss",
            "velocity comes 0.40 s after acceleration",
            "its filters or its time stamps",
        ),
        Finding("ok", "rate-as-expected", "rate", "ahrs", "50 Hz, expected 50"),
        Finding("ok", "shaft-on-time", "delay", "left", "the shaft follows 0.35 s later"),
    )
    t = np.arange(0.0, 60.0, 2.0)
    n = np.column_stack([np.sign(np.sin(t / 5.0)) * 0.6, np.sign(np.cos(t / 7.0)) * 0.6])
    way = np.linspace(0.0, 3.0, 200)
    track = PredictedTrack(20 * np.sin(way), 20 * (1 - np.cos(way)), "the design, by model horizontal", 2 * way)
    mission = DryRun("mixed, seed 1", ("left", "right"), t, n, 60.0, 60.0, track)
    return CheckReport("boat.toml", findings, (), "boat", mission)


def checked_log() -> CheckEvidence:
    """Return curves as `seatrial.ident.checks.log_checks.log_evidence` gives them."""
    rng, t = np.random.default_rng(8), np.arange(0.0, 48.0, 0.1)
    command = np.where(np.mod(t, 12.0) < 6.0, 0.3, -0.3)
    r = 0.2 * np.convolve(command, np.exp(-np.arange(0, 6, 0.1)), "full")[: t.size]
    noisy = r + 0.004 * rng.normal(size=t.size)
    heading = np.mod(np.cumsum(r) * 0.1 + 3.0, 2 * np.pi) - np.pi
    late = 0.02 + 0.002 * rng.exponential(size=t.size - 1)
    return CheckEvidence(
        "actuator-test", 48.0, "boat",
        intervals=(SampleIntervals("ahrs", t[1:], late, 0.02),
                   SampleIntervals("tide", t[1::50], np.full(10, 5.0), None)),
        shafts=(ShaftTrace("left", t, np.roll(command, 3), t[::60], command[::60], 48.0),),
        thrust_response=(ThrustResponseCurve("yaw rate", "rad/s", t, noisy, -r),),
        sensors=(SensorPair("yaw rate", "rad/s", ("of the heading, over 1 s", "of the gyro"), t, r, noisy),),
        signals=(SignalCurve("psi", "rad", t, heading, True),
                 SignalCurve("ax", "m/s2", t, rng.normal(size=t.size), False)),
    )  # fmt: skip


def design() -> DesignResult:
    """Return a designed mission with every key that `seatrial.ident.workflows.design` writes, and with fewer
    samples.
    """
    rng = np.random.default_rng(9)
    t = np.arange(0.0, 120.0, 0.5)
    levels = [np.repeat(rng.uniform(-1, 1, 12), 20) for _ in range(2)]
    way = np.linspace(0.0, 4.0, 200)
    track = {
        "t": np.linspace(0, 120, 200),
        "x": 15 * np.sin(way),
        "y": 15 * (1 - np.cos(way)),
        "radius": 2 * way,
        "inside": 0.97,
        "corner": (-25.0, -10.0),
        "area": (50.0, 45.0),
        "current": 0.0,
        "rest": 5.0,
        "coasting": 10.0,
    }
    track["others"] = [np.column_stack([track["x"] + k, track["y"] - k]) for k in range(8)]
    names = (("m_u", "kg", 37.0, "surge mass"), ("d_v", "kg/s", 50.0, "linear sway damping"))
    parameters = [
        {
            "name": n,
            "unit": u,
            "value": v,
            "meaning": m,
            "before": None,
            "after": 0.02 * v,
            "form": 0.01 * v,
            "baseline": 0.05 * v,
            "chosen": True,
        }
        for n, u, v, m in names
    ]
    samples = {n: rng.normal(size, 2.0, 1000) for n, size in (("design", 40.0), ("PRBS", 35.0), ("RGS", 33.0))}
    content = MADE | {
        "kind": "design",
        "command": "seatrial mission design horizontal --out next.toml",
        "model": "horizontal",
        "criterion": "D",
        "chosen": ["m_u", "d_v"],
        "form": "prediction error",
        "value": 41.2,
        "evaluations": 20000,
        "parameters": parameters,
        "baseline": "PRBS",
        "limited": True,
        "samples": samples,
        "share_won": 0.992,
        "baselines": [
            {"name": n, "value": v, "bandwidth": 0.2, "seeds": [v]} for n, v in (("PRBS", 36.0), ("RGS", 34.0))
        ],
        "inputs": [{"name": n, "t": t, "value": v} for n, v in zip(("left", "right"), levels, strict=True)],
        "track": track,
        "answer": "After this mission of 120 s the expected standard errors are m_u ±0.74 kg (2 %)",
    }
    return msgspec.convert(content, DesignResult, dec_hook=arrays)


def study() -> StudyResult:
    """Return two studies. In the second, one parameter certainly misses its aims and another may miss by chance."""
    fine = [_parameter("m_u", "kg", -0.04, 1.05, 0.942, ()), _parameter("d_u", "kg/s", 0.01, 0.98, 0.95, ())]
    poor = [
        _parameter("d_v", "kg/s", 0.04, 0.93, 0.89, ("coverage",)),
        _parameter("s_u", "m/s/sqrt(s)", -0.17, 1.02, 0.944, ("bias (chance?)",)),
    ]
    common = {
        "method": "PE",
        "estimator": "prediction error",
        "replicates": 500,
        "failed": 0,
        "unconverged": 1,
        "cpu_fit": 0.006,
        "cpu_simulation": 0.02,
    }
    content = MADE | {
        "kind": "study",
        "command": "seatrial ident study surge yaw",
        "seed": 1,
        "logs": [],
        "answer": "surge, 500 replicates: 2 of 2 parameters meet the aims. yaw: these miss them: d_v (coverage).",
        "studies": [
            common | {"model": "surge", "about": "300 s, steps of thrust", "parameters": fine},
            common | {"model": "yaw", "about": "300 s, steps of moment", "parameters": poor},
            common | {"model": "none", "about": "nothing converged", "parameters": []},
        ],
    }
    return msgspec.convert(content, StudyResult)


def _parameter(name: str, unit: str, bias: float, ratio: float, coverage: float, misses: tuple[str, ...]) -> Any:
    return {
        "name": name,
        "unit": unit,
        "truth": 37.0,
        "n": 499,
        "at_bound": 0,
        "sd": 0.1,
        "bias": bias,
        "bias_error": 0.04,
        "ratio": ratio,
        "ratio_low": 0.9 * ratio,
        "ratio_high": 1.13 * ratio,
        "bound_ratio": ratio,
        "bound_ratio_low": 0.9 * ratio,
        "bound_ratio_high": 1.13 * ratio,
        "coverage": coverage,
        "coverage_low": coverage - 0.02,
        "coverage_high": coverage + 0.02,
        "misses": list(misses),
    }

"""Examples of a thruster and a noise result for pages, from seeded numbers."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from seatrial.ident.characterisation.sensor_noise import band_spectrum
from seatrial.ident.results.commands import NoiseResult
from tests.ident.calibration_example import calibration
from tests.ident.navigation_example import arrays
from tests.ident.report_example import base, commands, fit, listed, log, parameter


def thruster() -> dict[str, Any]:
    """Return a thruster result of a bench: steady points and a step sequence."""
    rng = np.random.default_rng(5)
    table = [
        parameter("a", 2.794, 0.021, "1/s", "inverse time constant of the shaft"),
        parameter("c1", 40.05, 0.12, "N", "thrust at full speed, mean of ahead and astern"),
        parameter("c2", 1.11, 0.09, "N", "thrust at full speed, half of ahead less astern"),
        parameter("tau", 0.041, 0.003, "s", "delay from command to shaft"),
    ]
    result = base("thruster", "f = 40.05 n|n| + 1.11 n² (N), with a time constant of 0.358 s and a delay of 41 ms.")
    n, fine = np.linspace(-1, 1, 11), np.linspace(-1, 1, 101)
    steady = 40.05 * n * abs(n) + 1.11 * n**2 + 0.5 * rng.standard_normal(11)
    static = {"n": n, "force": steady, "sd": np.full(11, 0.5), "n_model": fine}
    static |= {"force_model": 40.05 * fine * abs(fine) + 1.11 * fine**2, "force_sd": 0.2 + 0.6 * fine**2}
    t = np.arange(0, 120, 0.02)
    command = commands(t, rng)[0]
    model = 40 * command * abs(command)
    common = {"record": "pool", "role": "estimation", "channel": "force", "unit": "N", "angle": False, "t": listed(t)}
    curves = {"measured": listed(model + rng.standard_normal(t.size)), "model": listed(model)}
    result |= {"logs": [log("pool", "estimation", 120.0)], "fit": {**fit(rng, table), "method": "OE"}}
    far = {"t_horizon": listed(t[50:]), "horizon": listed(model[50:]), "sd_horizon": listed(0.0 * t[50:] + 1.0)}
    result |= {"traces": [{**common, **curves, **far, "sd": listed(0.0 * t + 1.0), "before": None}]}
    result |= {"horizon_seconds": 1.0, "track": [], "residuals": [], "cross": [], "calibration": calibration()}
    result |= {"errors": {"estimation": {kind: {} for kind in ("one_step", "horizon", "simulation")}}}
    result |= {"static": {key: listed(a) for key, a in static.items()}}
    result |= {"inputs": [{"record": "pool", "name": "n_cmd", "unit": "", "t": listed(t), "value": listed(command)}]}
    return result


def noise() -> NoiseResult:
    """Return a noise result of three channels at rest. One is not white noise plus a random walk."""
    rng = np.random.default_rng(3)
    content = base("noise", "White noise plus a random walk describes gyro and heading; the position needs more.")
    frequency = np.geomspace(1e-3, 25, 4000)
    channels = []
    for channel, unit, white, walk, accepted in (
        ("r", "rad/s", 2.1e-3, 3.4e-6, True),
        ("psi", "rad", 8e-3, 1e-9, True),
        ("x", "m", 0.9, 0.02, False),
    ):
        model = white**2 / 25 + (walk / (2 * np.pi * frequency)) ** 2
        psd = model * rng.chisquare(2, 4000) / 2
        curves = {"frequency": frequency, "psd": psd, "psd_model": model}
        row = {"channel": channel, "unit": unit, "white": white, "random_walk": walk, "se_white": white / 90}
        row |= {"se_random_walk": walk / 8 if walk > 1e-6 else None, "reason": None}
        row |= {"random_walk_limit": None if walk > 1e-6 else 2e-5}
        row |= {"p": 0.37 if accepted else 1e-12, "accepted": accepted}
        row |= {"predictable": 0.0 if accepted else 0.42}
        bands = vars(band_spectrum(frequency, psd))
        row |= {"bands": {key: listed(a) for key, a in bands.items()}}
        channels.append(row | {key: listed(a) for key, a in curves.items()})
    content |= {"logs": [log("quay", "estimation", 3600.0)], "noise": channels, "format": "seatrial-result 3"}
    return msgspec.convert(content, NoiseResult, dec_hook=arrays)

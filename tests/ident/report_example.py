"""Example of a diagnosis for pages: an imaginary boat, from seeded numbers. It also has the parts of other examples."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.ident.calibration_example import calibration

ODE_STEP_S = 0.1  # Unit: s
SHAFTS = ("n_left", "n_right")
CHANNELS = (
    ("psi", "rad", 0.012, True),
    ("r", "rad/s", 0.006, False),
    ("ax", "m/s2", 0.05, False),
    ("x", "m", 0.15, False),
    ("y", "m", 0.15, False),
    ("vx", "m/s", 0.04, False),
    ("vy", "m/s", 0.04, False),
)
CANDIDATES = (
    ("advance-ratio", "loss of thrust with forward speed", 812.0, 1, False),
    ("X(u)", "surge force over surge speed", 803.0, 6, True),
    ("cubic-drag", "cubic drag in surge", 655.0, 1, False),
    ("X(n_sum)", "surge force over mean shaft speed", 410.0, 5, True),
    ("turning-resistance", "resistance from turning", 128.0, 1, False),
    ("battery-sag", "thrust lost as the battery empties", 61.0, 1, False),
    ("N(u, r)", "yaw moment over products of u and r", 44.0, 3, True),
    ("mismatch", "left and right thrusters differ", 21.0, 1, False),
    ("wind", "steady wind", 14.2, 2, False),
    ("coulomb", "friction that does not grow with speed", 9.6, 1, False),
    ("gnss-latency", "late positions", 5.1, 1, False),
    ("mount", "misaligned heading sensor", 2.2, 1, False),
    ("yaw-bias", "constant yaw moment", 0.7, 1, False),
)


def commands(t: Any, rng: Any) -> tuple[Any, Any]:
    """Return steps of random size of left and right, each for eight seconds."""
    hold = (t // 8).astype(int)
    return tuple(rng.uniform(-0.3, 0.9, hold.max() + 1)[hold] for _ in range(2))  # type: ignore[return-value]


def boat(n: tuple[Any, Any], k_J: float) -> dict[str, Any]:
    """Simulate a small boat with two thrusters. Return every channel over time."""
    left, right = n
    u, v, r, psi, x, y = 0.0, 0.0, 0.0, 0.4, 0.0, 0.0
    rows = []
    for a, b in zip(left, right, strict=True):
        loss = k_J * u
        f = (40 * a * abs(a) - loss * abs(a), 40 * b * abs(b) - loss * abs(b))
        du = (f[0] + f[1] - 25 * abs(u) * u - 0.2 * u + 47 * v * r) / 37
        dv = (-50 * v - 37 * u * r) / 47
        dr = (0.15 * (f[0] - f[1]) - 4.1 * r - 6.2 * abs(r) * r) / 9.7
        vx, vy = np.cos(psi) * u - np.sin(psi) * v + 0.05, np.sin(psi) * u + np.cos(psi) * v - 0.03
        rows.append((psi, r, du - v * r, x, y, vx, vy))
        u, v, r, psi = u + ODE_STEP_S * du, v + ODE_STEP_S * dv, r + ODE_STEP_S * dr, psi + ODE_STEP_S * r
        x, y = x + ODE_STEP_S * vx, y + ODE_STEP_S * vy
    return dict(zip([c[0] for c in CHANNELS], np.array(rows).T, strict=True))


def listed(a: Any) -> list[float | None]:
    values = np.asarray(a, float)
    found: list[float | None] = values.tolist()
    for k in np.flatnonzero(~np.isfinite(values)):
        found[k] = None
    return found


def record(rng: Any, name: str, role: str, duration: float) -> dict[str, Any]:
    """Return traces, track, inputs, residuals, cross-correlations and residual forces of one record."""
    t = np.arange(0, duration, ODE_STEP_S)
    n = commands(t, rng)
    truth, before = boat(n, 6.1), boat(n, 0.0)
    tag = {"record": name, "role": role}
    traces, track = [], {**tag}
    for channel, unit, sd, angle in CHANNELS:
        measured = truth[channel] + sd * rng.standard_normal(t.size)
        if channel in ("x", "y", "vx", "vy"):
            measured[np.arange(t.size) % 2 == 1] = np.nan
            measured[(t > 0.5 * duration) & (t < 0.5 * duration + 12)] = np.nan
        drift = sd * np.cumsum(rng.standard_normal(t.size)) / np.sqrt(t.size)
        model, spread = truth[channel] + drift, sd * (0.6 + t / duration)
        if angle:
            measured, model = (np.mod(a + np.pi, 2 * np.pi) - np.pi for a in (measured, model))
        if channel in ("x", "y"):
            track |= {f"{channel}_measured": listed(measured), f"{channel}_model": listed(model)}
            track[f"{channel}_before"] = listed(before[channel])
        values = {"t": t, "measured": measured, "model": model, "sd": spread, "before": before[channel]}
        late = t >= 10.0
        near, worse = (truth[channel] + k * sd * np.sin(t / 9) for k in (1.0, 3.0))
        far = {"t_horizon": t, "horizon": near, "sd_horizon": np.full(t.size, sd), "horizon_before": worse}
        values |= {key: a[late] for key, a in far.items()}
        common = {**tag, "channel": channel, "unit": unit, "angle": angle}
        traces.append(common | {key: listed(a) for key, a in values.items()})
    shafts = zip(SHAFTS, n, strict=True)
    inputs = [{"record": name, "name": k, "unit": "", "t": listed(t), "value": listed(a)} for k, a in shafts]
    return {
        "traces": traces,
        "track": [track],
        "inputs": inputs,
        "residuals": [{"record": name, "channel": c[0], "unit": c[1], **residual(rng, t)} for c in CHANNELS],
        "cross": [cross(rng, name, c[0], i, 9 / (k + 1)) for k, c in enumerate(CHANNELS) for i in SHAFTS],
        "residual_forces": [force(rng, name, f, unit, t) for f, unit in (("X", "N"), ("Y", "N"), ("N", "N m"))],
    }


def whiteness(rng: Any, t: Any, memory: float) -> dict[str, Any]:
    """Return the innovations of a first-order process with their tests."""
    e = rng.standard_normal(t.size)
    for k in range(1, e.size):
        e[k] = memory * e[k - 1] + np.sqrt(1 - memory**2) * e[k]
    power = np.abs(np.fft.rfft(e)[1:]) ** 2
    lags = np.arange(1, 26)
    white = memory < 0.1
    return {
        "t": listed(t),
        "e": listed(e),
        "lags": listed(lags * ODE_STEP_S),
        "acf": listed([float(e[k:] @ e[:-k] / (e @ e)) for k in lags]),
        "band": 1.96 / np.sqrt(t.size),
        "ljung_box_p": 0.31 if white else 3e-41,
        "periodogram_p": 0.44 if white else 2e-9,
        "normal_p": 0.62 if white else 0.04,
        "white": white,
        "outliers": 0,
        "largest": float(np.abs(e).max()),
        "frequency": listed(np.fft.rfftfreq(t.size, ODE_STEP_S)[1:]),
        "cumulative": listed(np.cumsum(power) / power.sum()),
    }


def residual(rng: Any, t: Any) -> dict[str, Any]:
    after = whiteness(rng, t, 0.0)
    own = ("t", "lags", "band", "frequency")
    return {**whiteness(rng, t, 0.35), "after": {key: after[key] for key in after if key not in own}}


def cross(rng: Any, name: str, channel: str, key: str, size: float) -> dict[str, Any]:
    lags = np.linspace(0, 3, 31)
    z = size * np.exp(-lags) + 0.6 * rng.standard_normal(31)
    after = {"z": listed(0.8 * rng.standard_normal(31)), "p": 0.4}
    tag = {"record": name, "channel": channel, "input": key}
    return {**tag, "lags": listed(lags), "z": listed(z), "p": 4e-7, "after": after}


def force(rng: Any, name: str, key: str, unit: str, t: Any) -> dict[str, Any]:
    size = {"X": 6.0, "Y": 1.0, "N": 0.3}[key]
    mean = size * np.sin(t / 19) * np.sin(t / 7) - size / 2 + 0.05 * size * rng.standard_normal(t.size)
    curves = {"t": t, "mean": mean, "sd": np.full(t.size, 0.3 * size)}
    curves |= {"after_mean": 0.1 * mean, "after_sd": np.full(t.size, 0.25 * size)}
    return {"record": name, "force": key, "unit": unit} | {k: listed(a) for k, a in curves.items()}


def parameter(name: str, value: float, se: float | None, unit: str, meaning: str, **more: Any) -> dict[str, Any]:
    common = {"name": name, "meaning": meaning, "unit": unit, "value": value, "se": se, "free": True, "start": value}
    return {**common, "prior_share": 0.02, "flag": None, "record": None, **more}


def parameters() -> list[dict[str, Any]]:
    return [
        parameter("m_u", 37.42, 0.31, "kg", "surge mass with added mass"),
        parameter("m_v", 46.1, 1.9, "kg", "sway mass with added mass"),
        parameter("m_r", 9.712, 0.048, "kg m2", "yaw inertia with added inertia"),
        parameter("d_u", 0.0, None, "kg/s", "linear surge damping", flag="at its bound"),
        parameter("d_v", 51.3, 2.7, "kg/s", "linear sway damping"),
        parameter("d_r", 4.08, 0.11, "kg m2/s", "linear yaw damping"),
        parameter("d_uu", 25.31, 0.22, "kg/m", "quadratic surge damping"),
        parameter("d_rr", 6.31, 0.19, "kg m2", "quadratic yaw damping"),
        parameter("c1", 40.05, None, "N", "thrust at full speed, mean of ahead and astern", free=False),
        parameter("V_x", 0.051, 0.006, "m/s", "current to the north", record="morning", prior_share=0.21),
        parameter("V_y", -0.033, 0.007, "m/s", "current to the east", record="morning", prior_share=0.18),
        parameter("e_psi", 0.01204, 0.00012, "rad", "noise of the heading"),
        parameter("s_r", 2.31e-5, 4.4e-6, "rad/s/sqrt(s)", "process noise of yaw rate"),
        parameter("k_J", 6.08, 0.27, "kg/s", "thrust lost per forward speed at full shaft speed"),
    ]


def correlation(rng: Any, names: list[str]) -> dict[str, Any]:
    root = rng.standard_normal((len(names), 2 * len(names))) + 0.5
    table = root @ root.T
    size = np.sqrt(np.diag(table))
    return {"names": names, "matrix": (table / np.outer(size, size)).tolist()}


def errors(rng: Any, scale: float) -> dict[str, Any]:
    sizes = {"one_step": (1.0, 0.96), "horizon": (3.0, 0.6), "simulation": (22.0, 0.3)}
    found: dict[str, Any] = {}
    for horizon, (size, ratio) in sizes.items():
        table = found[horizon] = {}
        for channel, unit, sd, _ in CHANNELS:
            own = ratio * rng.uniform(0.85, 1.15) if channel != "ax" else 1.004
            row = {"before": scale * size * sd, "after": scale * size * sd * own, "unit": unit}
            row |= {"spread": scale * size * sd * 40.0}
            verdict = "unchanged" if own > 0.9 else "fell"
            interval = {"low": 0.9 * own, "high": 1.11 * own, "verdict": verdict}
            table[channel] = row | (interval if horizon == "horizon" else {})
    return found


def diagnosis_round(chosen: str | None, factor: float, why: str) -> dict[str, Any]:
    candidates = []
    for name, title, lm, df, generic in CANDIDATES:
        size = lm * factor
        p = float(np.exp(-size / 2))
        row = {"name": name, "title": title, "lm": size, "df": df, "p": p, "p_block": min(1.0, p**0.5)}
        candidates.append({**row, "threshold": 14.0, "generic": generic, "passed": size > 14})
    k_J = {"name": "k_J", "meaning": "thrust lost", "value": 6.08, "se": 0.27, "unit": "kg/s"}
    gains = ((0, 790.0, 312.0, 9.4), (2, 661.0, 240.0, 8.1), (1, 803.0, 296.0, 9.0))
    refits = []
    for index, gain, validation, t in gains:
        name, title, _, df, _ = CANDIDATES[index]
        row = {"name": name, "title": title, "gain": gain * factor, "df": df, "criterion": gain * factor - df * 9.2}
        row |= {"validation_gain": validation * factor, "t": t * factor, "parameters": [k_J] * df}
        refits.append({**row, "outcome": "added" if name == chosen else "outranked"})
    counts = {"tested": 73, "passed": sum(row["passed"] for row in candidates)}
    return {**counts, "candidates": candidates, "refits": refits, "chosen": chosen, "why": why}


def effect() -> dict[str, Any]:
    k_J = {"name": "k_J", "meaning": "thrust lost per forward speed", "unit": "kg/s", "value": 6.08, "se": 0.27}
    return {
        "name": "advance-ratio",
        "title": "loss of thrust with forward speed",
        "formula": "f_i -= k_J |n_i| (u - y_i r)",
        "source": "Blanke 1981, bilinear thrust; Fossen 2011, section 9.3",
        "place": "actuator",
        "experiment": "steps of both thrusters at several speeds, then full astern while still moving ahead",
        "alternatives": [{"name": "cubic-drag", "title": "cubic drag in surge", "criterion_behind": 129.0}],
        "attribution": "identified",
        "reasons": [],
        "not_excluded": [],
        "parameters": [k_J],
        "in_words": "the thrust falls by 6.1 N for each m/s at full speed",
        "prediction": {"role": "validation", "ratio": 1 / 1.72, "low": 0.5, "high": 0.66, "verdict": "fell"},
        "error_ratio_without": 1.72,
        "gain_last": 640.0,
    }


def diagnosis() -> dict[str, Any]:
    """Return a complete diagnosis with every key that this kind of result may have."""
    rng = np.random.default_rng(11)
    answer = (
        "The thrusters lose thrust with forward speed: k_J = 6.08 ± 0.27 kg/s removes 72 % of the error on new data."
    )
    result = base("diagnosis", answer)
    takes = [record(rng, "morning", "estimation", 600.0), record(rng, "afternoon", "validation", 300.0)]
    for key in takes[0]:
        result[key] = [row for take in takes for row in take[key]]
    result["logs"] = [log("morning", "estimation", 600.0), log("afternoon", "validation", 300.0)]
    result["fit"] = fit(rng)
    before = (35.1, 48.0, 9.70, 0.4, 50.1, 4.2, 28.9, 6.2)
    names = parameters()[:8]
    result["parameters_before_after"] = [
        {
            "name": p["name"],
            "unit": p["unit"],
            "before": b,
            "after": p["value"],
            **dict.fromkeys(("before_se", "after_se"), p["se"]),
        }
        for p, b in zip(names, before, strict=True)
    ]
    yes = "advance-ratio has the best criterion (781, cubic-drag is 129 behind) and gains on validation data (t = 9.4)."
    result["rounds"] = [
        diagnosis_round("advance-ratio", 1.0, yes),
        diagnosis_round(None, 0.009, "No candidate passes the test: what is left looks like noise."),
    ]
    result["effects"] = [effect()]
    result["converged_before"] = True
    change = {"role": "validation", "ratio": 0.65, "low": 0.6, "high": 0.7, "verdict": "fell"}
    result["prediction"] = change | {"better": ["psi", "x"], "worse": []}
    grid = np.linspace(-0.4, 1.6, 60)
    curve = {"grid": grid, "value": 2 - 5 * grid**2, "sd": 0.4 + 0.6 * (grid - 0.6) ** 2}
    curve |= {"band": 1.0 + 1.6 * (grid - 0.6) ** 2}
    drawn = {"force": "X", "sensor_error": False, "variable": "u", "unit": "N", "variable_unit": "m/s"}
    result["nonparametric_effects"] = [drawn | {key: listed(a) for key, a in curve.items()}]
    result["errors"] = {"validation": errors(rng, 1.0), "estimation": errors(rng, 0.9)}
    result["calibration"] = calibration()
    result |= {"caveat": None, "horizon_seconds": 10.0}
    result["recommended_experiment"] = "Full astern while still moving ahead: it tells advance-ratio from cubic-drag."
    result["notes"] = ["Sway damping rests on its prior in part.", "GNSS was lost for 12 s in each record."]
    return result


def log(name: str, role: str, duration: float) -> dict[str, Any]:
    warnings = ["3 frames of the AHRS were corrupt"] if role == "estimation" else []
    common = {"path": f"logs/{name}.mcap", "sha256": "9f2c41d07b" * 6 + "9f2c", "role": role, "name": name}
    return {**common, "duration": duration, "rig": "twin", "mission": "steps-D-optimal", "warnings": warnings}


def fit(rng: Any, table: list[dict[str, Any]] | None = None) -> dict[str, Any]:
    table = table or parameters()
    common = {"model": "horizontal", "method": "PE", "converged": True, "message": "gradient is small"}
    common |= {"restricted": True, "second_order": True}
    names = [p["name"] for p in table if p["se"]]
    common["iterations"] = 12
    more = {"log_likelihood": 104211.7, "cpu": 4.31, "parameters": table, "correlation": correlation(rng, names)}
    return common | more


def base(kind: str, answer: str) -> dict[str, Any]:
    common = {"format": "seatrial-result 3", "kind": kind, "answer": answer, "created": "2025-05-06T07:08:09Z"}
    return {**common, "seatrial": "0.1.0", "command": f"seatrial ident {kind} morning.mcap --validate afternoon.mcap"}

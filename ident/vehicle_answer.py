"""What the fit of a vehicle says in a sentence or two."""

from __future__ import annotations

import numpy as np

from ident.outcome import FEWEST, Json

WORDS = {
    "x": "position",
    "vx": "velocity",
    "psi": "heading",
    "u": "surge speed",
    "r": "yaw rate",
    "speed": "speed over ground",
}
SPELLED = {1.0: "One second", 10.0: "Ten seconds"}
LEVEL = 0.01
MEASURED = {"phi", "theta", "psi", "p", "q", "r"}  # inputs that are a sensor's output, with its noise


def vehicle_answer(result: Json, *, searchable: bool) -> str:
    """The error over the horizon, and what the residuals know. ``searchable``: `ident diagnose` can search further."""
    roles = result["before_after"]
    role = "validation" if "validation" in roles else "estimation"
    rows = roles[role]["ten_seconds"]
    words = {n: w for n, w in WORDS.items() if n in rows} or {n: n for n in rows}
    said = []
    for name, word in words.items():
        degrees = rows[name]["unit"].startswith("rad")
        value, unit = rows[name]["after"], rows[name]["unit"].replace("rad", "deg")
        said.append(f"{word} {value * 180 / np.pi if degrees else value:.2g} {unit}".rstrip())
    horizon = SPELLED.get(result["horizon"], f"{result['horizon']:g} s")
    ahead = f"{horizon} ahead on {role} data the model errs by {', '.join(said)} (rms). " if said else ""
    return f"{ahead}{_residuals(result, searchable)}"


def _residuals(result: Json, searchable: bool) -> str:
    """Each at 1 % over all channels, tests and inputs together (Bonferroni)."""
    tests = [p for r in result["residuals"] for p in (r["ljung_box_p"], r["periodogram_p"])]
    cross = [(c["p"], c["input"]) for c in result["cross"] if c["p"] is not None]
    known = {name for p, name in cross if p * len(cross) < LEVEL}
    coloured = any(p is not None and p * len(tests) < LEVEL for p in tests)
    if not tests:
        least = f"that takes {FEWEST} samples of a channel"
        return f"Too little was measured to tell whether the residuals are white: {least}."
    if not known and not coloured:
        hidden = "; whether the unexplained forces hide an effect, `seatrial ident diagnose` tells"
        return f"The residuals are white and know nothing of the inputs{hidden if searchable else ''}{_unseen(result)}."
    if known and known <= MEASURED:
        named = " and ".join(sorted(known))
        return (
            f"The residuals still know {named}, which the model takes as measured: that may be the noise of these "
            f"measurements and need not be a lack of the model{'. They are not white' if coloured else ''}."
        )
    end = "The residuals still know the inputs" if known else "The residuals are not white"
    how = ": run `seatrial ident diagnose` to find what is missing" if searchable else ": the model lacks something"
    return f"{end}{how}."


def _unseen(result: Json) -> str:
    """Channels of the estimation data with too few samples to say so."""
    seen = {r["channel"] for r in result["residuals"]}
    left = [n for n in result["before_after"].get("estimation", {}).get("one_step", {}) if n not in seen]
    return f" (of {', '.join(left)} there are too few to tell)" if left else ""

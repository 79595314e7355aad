"""What the fit of a vehicle says in a sentence or two."""

from __future__ import annotations

import numpy as np

from ident.outcome import Json

WORDS = {
    "x": "position",
    "vx": "velocity",
    "psi": "heading",
    "u": "surge speed",
    "r": "yaw rate",
    "speed": "speed over ground",
}


def vehicle_answer(result: Json, *, searchable: bool) -> str:
    """The error ten seconds ahead, and what the residuals know. ``searchable``: `ident diagnose` can search further."""
    roles = result["before_after"]
    role = "validation" if "validation" in roles else "estimation"
    rows = roles[role]["ten_seconds"]
    words = {n: w for n, w in WORDS.items() if n in rows} or {n: n for n in rows}
    said = []
    for name, word in words.items():
        degrees = rows[name]["unit"].startswith("rad")
        value, unit = rows[name]["after"], rows[name]["unit"].replace("rad", "deg")
        said.append(f"{word} {value * 180 / np.pi if degrees else value:.2g} {unit}".rstrip())
    ahead = f"Ten seconds ahead on {role} data the model errs by {', '.join(said)} (rms). " if said else ""
    correlated = any(c["p"] is not None and c["p"] < 1e-3 for c in result["cross"])
    coloured = any(not r["white"] for r in result["residuals"])
    if not correlated and not coloured:
        hidden = "; whether the unexplained forces hide an effect, `seatrial ident diagnose` tells"
        return f"{ahead}The residuals are white and know nothing of the inputs{hidden if searchable else ''}."
    end = "The residuals still know the inputs" if correlated else "The residuals are not white"
    how = ": run `seatrial ident diagnose` to find what is missing" if searchable else ": the model lacks something"
    return f"{ahead}{end}{how}."

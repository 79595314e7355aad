"""Titles of candidates for a missing effect in words, for effects that have no title in the catalogue."""

from __future__ import annotations

import re

from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import between_runs_title

FORCES = {
    "X": "surge force",
    "Y": "sway force",
    "N": "yaw moment",
    "r_ref": "steady yaw rate",
    "T": "thrust of both thrusters",
    "T_left": "thrust of the left thruster",
    "T_right": "thrust of the right thruster",
    "psi": "heading error",
    "r": "yaw rate error",
    "ax": "error of the surge acceleration",
    "ay": "error of the sway acceleration",
    "F": "force on the load cell",
    "n_dot": "acceleration of the shaft",
}
VARIABLES = {
    "u": "surge speed",
    "v": "sway speed",
    "r": "yaw rate",
    "psi": "heading",
    "t": "time",
    "n_sum": "mean of the shaft speeds",
    "n_diff": "difference of the shaft speeds",
    "f_sum": "mean of the thrusts",
    "f_diff": "difference of the thrusts",
    "n": "shaft speed",
    "n_ref": "command",
    "slip": "difference of command and shaft speed",
}
WAYS = {"past of ": "follows the {} with a lag", "swing after ": "oscillates after the {}", "": "follows the {}"}


def candidate_title(name: str) -> str:
    """Return the title of a candidate in words; a name without words is returned unchanged.

    An effect of the catalogue has its own title. The name of a curve follows its words: ``psi(n_diff)`` becomes
    ``heading error that follows the difference of the shaft speeds, psi(n_diff)``. ``between-runs:m_v`` becomes
    ``m_v differs between the runs``.
    """
    if name in catalogue():
        return catalogue()[name].title
    words = curve_words(name)
    return f"{words}, {name}" if words else between_runs_title(name)


def curve_words(name: str) -> str:
    """Return the meaning of the name of a curve in words, such as that of ``X(u)`` or ``N(u, r)``.

    The text is empty for a name that is not that of a curve.
    """
    found = re.fullmatch(r"(\w+)\((past of |swing after |)(\w+)(?:, (\w+))?\)", name)
    if found is None:
        return ""
    force, way, *variables = found.groups()
    named = [VARIABLES.get(v, v) for v in variables if v]
    of = named[0] if len(named) == 1 else f"product of {' and '.join(named)}"
    return f"{FORCES.get(force, force)} that {WAYS[way].format(of)}"

"""Line that the boat tows at its stern, such as an umbilical: its end stays in the water until the line is taut."""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.model import INF, Effect, Estimates, Parameter, Signals, State, directed_size, size_in_words

STRETCH = 0.02  # of the length; over this stretch the line becomes taut, because a filter needs a smooth tension
# Largest speed of the end of the line, relative to that of the tow point. A line of exactly its length is drawn with
# the speed of the tow point. With a largest speed of 1, the line would stretch without limit: it became a third longer,
# and the linear model had a time constant of days.
LARGEST = 1.05
SHORT_M = 0.05  # distance [m] below which the direction of the line is rounded


def drawn(s: Signals) -> tuple[Any, Any, Any]:
    """Return the speed [m/s] with which the end of the line is drawn, and the direction forward and to starboard.

    The direction is a unit vector in body axes from the end of the line to the tow point; it is rounded to a shorter
    vector within about 5 cm. The speed is that of the tow point along the line if the line is taut, and zero if it is
    slack or pushed, with smooth transitions.
    """
    p, x = s.p, s.x
    distance = np.sqrt(x.line_x * x.line_x + x.line_y * x.line_y + SHORT_M * SHORT_M)
    forward, starboard = x.line_x / distance, x.line_y / distance
    along = x.u * forward + (x.v + p.x_line * x.r) * starboard
    taut = LARGEST / (1 + (LARGEST - 1) * np.exp(np.minimum((1 - distance / p.l_line) / STRETCH, 50.0)))
    return taut * (along + np.sqrt(along * along + 1e-4)) / 2, forward, starboard


def pull(s: Signals) -> None:
    """Add the pull of the towed line to ``s.X``, ``s.Y`` [N] and ``s.N`` [N m], in place.

    It acts at the tow point, ``x_line`` forward of the origin, towards the end of the line. Its size is ``k_line``
    times the squared speed with which the end of the line is drawn.
    """
    speed, forward, starboard = drawn(s)
    tension = s.p.k_line * speed * speed
    s.X = s.X - tension * forward
    s.Y = s.Y - tension * starboard
    s.N = s.N - s.p.x_line * tension * starboard


def trail(s: Signals) -> None:
    """Set the rates of the vector from the end of the line to the tow point [m/s], in body axes.

    The end rests in the water unless it is drawn, so the vector changes with the velocity of the tow point through the
    water and with the turn of the boat.
    """
    x, (speed, forward, starboard) = s.x, drawn(s)
    s.rate["line_x"] = x.u + x.r * x.line_y - speed * forward
    s.rate["line_y"] = x.v + s.p.x_line * x.r - x.r * x.line_x - speed * starboard


def size(estimates: Estimates) -> str:
    """Return a clause for reports: "a pull of 12 ± 2 N at 1 m/s, a length of 8 ± 1 m, ...".

    Only ``k_line``, ``l_line`` and ``x_line`` are used. The tow point is forward or aft of the origin of the model.
    """
    pull_at_1 = size_in_words(*estimates["k_line"], "N")
    point = directed_size(estimates["x_line"], "m", "forward", "aft")
    return f"a pull of {pull_at_1} at 1 m/s, a length of {size_in_words(*estimates['l_line'], 'm')}, tow point {point}"


EFFECT = Effect(
    name="towed-line",
    title="a line or umbilical that the boat tows",
    place="environment",
    hooks={"force": pull, "rate": trail},
    parameters=(
        Parameter(
            "k_line",
            0.0,
            "kg/m",
            "drag of the line per squared speed",
            prior=(0.0, 10.0),
            bounds=(0.0, INF),
            step=0.3,
        ),
        Parameter("l_line", 8.0, "m", "length of the line", "log", prior=(8.0, 6.0), bounds=(0.3, 200.0)),
        Parameter("x_line", -0.5, "m", "position of the tow point forward of the origin", prior=(-0.5, 0.3), step=0.05),
    ),
    states=(
        State("line_x", "m", "tow point forward of the end of the line", 0.0, "l_line", sd0=0.5),
        State("line_y", "m", "tow point to starboard of the end of the line", 0.0, 0.0, sd0=1.0),
    ),
    scan={"l_line": (1.0, 2.0, 4.0, 6.0, 9.0, 14.0, 22.0)},
    formula="F = -k V^2 e at x_line; V = max(w e, 0) if |d| = l, else 0; d' = w - V e the vector from the end of the "
    "line to the tow point, e = d / |d|, w the velocity of the tow point through the water",
    source="quasi-steady towing of a short line, whose end is drawn through the water; Faltinsen 1990, chapter 8",
    causes="a line, an umbilical or a sensor that the boat tows",
    experiment="zigzags and turns at several speeds, with and without the line",
    requires=("hull",),
    one_sided=True,
    alternatives=("tether", "sway-yaw", "cg-offset", "turning-resistance"),
    in_words=size,
)

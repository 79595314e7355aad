"""Dead zone of a command, and dead band of a thruster.

Outside a dead zone, the command passes unchanged: a shaft that does not turn for small commands. Outside a dead band,
the shaft speed is reduced by the width of the band: a propeller that gives no thrust at low speed.

The transition at the end of a dead zone is smooth, because estimators need its derivative. The check of a log
(`seatrial.ident.checks.shafts`) tries dead zones on a grid, and has no transition.
"""

from __future__ import annotations

from typing import Any

import numpy as np

MIN_WIDTH = 1e-9  # lower limit of the width of a transition, against division by zero


def transition_width(dead_zone: Any, widest: float) -> Any:
    """Return the width of a transition at the end of a dead zone that is estimated from zero on.

    The width is ``widest`` or, if smaller, twice ``dead_zone``. The transition of a small dead zone thus begins at zero
    command, and its middle stays at the end of the dead zone. A dead zone of zero has no transition.
    """
    return np.minimum(widest, 2.0 * dead_zone)


def outside_dead_zone(command: Any, dead_zone: Any, width: Any) -> Any:
    """Return the command outside its dead zone, and zero inside it.

    Parameters
    ----------
    command : float or symbol
        Command relative to full command, -1 to 1.
    dead_zone : float or symbol
        End of the dead zone, >= 0: the middle of the transition, where half of the command passes.
    width : float or symbol
        Width of the smooth transition, in units of the command. With zero width and a dead zone of zero, the result is
        the command itself.
    """
    end = dead_zone + width / 2.0
    # Measured from the outer end of the transition. If dead zone and width are zero, so is this end: no command lies
    # inside.
    inside = np.minimum(np.maximum((end - abs(command)) / np.maximum(width, MIN_WIDTH), 0.0), 1.0)
    return command * (1.0 - inside * inside * (3.0 - 2.0 * inside))


def beyond_dead_band(n: Any, band: Any) -> Any:
    """Return the part of the shaft speed n beyond the dead band: sgn(n) max(|n| - band, 0).

    Parameters
    ----------
    n : float or symbol
        Shaft speed relative to full speed.
    band : float or symbol
        Largest shaft speed without thrust, >= 0.
    """
    beyond = abs(n) - band
    return (beyond > 0) * beyond * ((n > 0) - 1.0 * (n < 0))

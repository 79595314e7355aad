"""Dead zone of a command, and dead band of a thruster.

Dead zone: a shaft does not turn for small commands, and outside the dead zone the command passes unchanged. Dead band:
a propeller gives no thrust at low shaft speed, and beyond the band the shaft speed is reduced by the width of the band.

The transition at the end of a dead zone is smooth, because estimators need its derivative. The check of a log
(`seatrial.ident.checks.shafts`) tries dead zones on a grid, and has no transition.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from seatrial.ident.model import Flag

# Flag of a fitted dead zone
TURNS_INSIDE = Flag("contradicted", "no dead zone of the thruster: the shaft turns at commands inside it")
MIN_WIDTH = 1e-9  # lower limit of the width of a transition, against division by zero


def transition_width(dead_zone: Any, widest: float) -> Any:
    """Return the width of the smooth transition at the end of a dead zone, also for a dead zone of zero.

    Parameters
    ----------
    dead_zone : float or symbol
        End of the dead zone, >= 0, in units of the command (1: full command).
    widest : float
        Largest width, in units of the command.

    Returns
    -------
    float or symbol
        ``widest`` or, if smaller, twice ``dead_zone``: the transition of a small dead zone then begins at zero command,
        and its middle is at the end of the dead zone. The width is zero for a dead zone of zero.
    """
    return np.minimum(widest, 2.0 * dead_zone)


def outside_dead_zone(command: Any, dead_zone: Any, width: Any) -> Any:
    """Return the command outside its dead zone, and zero inside it, with a smooth transition between both.

    A motor controller ignores small commands and follows larger ones completely. The result therefore rises steeply to
    the command itself, in contrast to `beyond_dead_band`, which begins at zero and stays below the shaft speed.

    Parameters
    ----------
    command : float or symbol
        Command relative to full command, -1 to 1.
    dead_zone : float or symbol
        End of the dead zone, >= 0. It is the middle of the transition, where half of the command passes if ``width`` is
        not zero.
    width : float or symbol
        Width of the transition, >= 0, in units of the command. If both ``width`` and ``dead_zone`` are zero, the result
        is the command itself.

    Returns
    -------
    float or symbol
        Zero up to ``dead_zone - width / 2``, and the command itself from ``dead_zone + width / 2`` on, for both signs.
    """
    end = dead_zone + width / 2.0
    # Measured from the outer end of the transition. If dead zone and width are zero, so is this end: no command lies
    # inside.
    inside = np.minimum(np.maximum((end - abs(command)) / np.maximum(width, MIN_WIDTH), 0.0), 1.0)
    return command * (1.0 - inside * inside * (3.0 - 2.0 * inside))


def beyond_dead_band(n: Any, band: Any) -> Any:
    """Return the part of the shaft speed beyond the dead band: ``sgn(n) max(|n| - band, 0)``.

    A propeller gives thrust only beyond the band, and less thrust by the width of the band at all larger speeds. The
    result is therefore continuous without a transition, in contrast to `outside_dead_zone`.

    Parameters
    ----------
    n : float or symbol
        Shaft speed relative to full speed, negative in reverse.
    band : float or symbol
        Width of the dead band: largest shaft speed without thrust, >= 0, relative to full speed.
    """
    beyond = abs(n) - band
    return (beyond > 0) * beyond * ((n > 0) - 1.0 * (n < 0))

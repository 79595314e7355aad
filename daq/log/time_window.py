"""Interval of the time of a log: the options `--from` and `--to`, and the part of a log in the interval."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from seatrial.daq.errors import SeatrialError
from seatrial.daq.options import FiniteRange
from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar, Servo

if TYPE_CHECKING:
    from seatrial.daq.log.reader import Log

USED: tuple[Any, ...] = (Ahrs, Gnss, Esc, LoadCell, Servo, Scalar, Command)  # kinds of samples that a fit can use
FIRST_S = 60.0  # s at the start of a log in which its first sample is looked for, as by a fit


class TimeWindow(NamedTuple):
    """Interval of time of a log to use, ``t_from <= t <= t_to``: a fit uses a sensor sample exactly at ``t_to`` too.

    Only the signals of `seatrial.api.logs.open_log` end before ``t_to``. The means of a sensor that is averaged end
    within half a block before or after it.

    Attributes
    ----------
    t_from : float
        Start [s], from the first sample of the log. 0: records start where all signals are known.
    t_to : float
        End [s], from the first sample of the log; infinite: to the end of the log.
    """

    t_from: float = 0.0
    t_to: float = math.inf

    def check(self) -> None:
        """Raise ValueError if the end is not after the start, or if one of them is NaN."""
        if not self.t_from < self.t_to:
            raise ValueError(f"--to {self.t_to:g} s is not after --from {self.t_from:g} s; give a later end")

    @property
    def label(self) -> str:
        """Text after the name of a log, such as ``[20:80]``; empty for the whole log."""
        return "" if self == TimeWindow() else f"[{self.t_from:g}:{self.t_to:g}]"


WHOLE = TimeWindow()


def part_in(log: Log, window: TimeWindow) -> Log:
    """Return a view of a log with the messages of an interval of time only; for `WHOLE` the log itself.

    Raises
    ------
    SeatrialError
        If the log ends before the interval.
    """
    if window == WHOLE:
        return log
    zero = first_sample(log)
    if zero + window.t_from >= log.end:
        raise SeatrialError(
            f"{log.path}: is {log.end - zero:.0f} s long, so no data are left from {window.t_from:g} s on; choose an "
            "earlier start"
        )
    return log.part(zero + window.t_from, math.nextafter(zero + window.t_to, math.inf))


def first_sample(log: Log) -> float:
    """Return the time of the first sample that a fit can use [s since 1970], from which the times of a log count.

    A fix counts from the first position on. Without such a sample in the first minute, it is the start of the log.
    """
    import numpy as np  # imported here, because --help needs none

    from seatrial.daq.log.schema import NODE_TOPICS

    firsts = list[float]()
    for kind in USED:
        column = {Gnss: "lat", Scalar: "value"}.get(kind, "t")
        for source in log.sources(kind):
            for node in log.nodes(kind, source) if kind in NODE_TOPICS else (None,):
                table = log.table(kind, source, node, log.start, log.start + FIRST_S)
                firsts += table["t"][np.isfinite(table[column])][:1].tolist()
    return min(firsts, default=log.start)


def window_option(f: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command with ``--from`` and ``--to`` [s of the log]: the interval of time of the logs to use.

    The command receives both as one ``window`` (`TimeWindow`); by default this is the whole log. If the end is not
    after the start, click.UsageError is raised, and the command is not called.
    """

    @wraps(f)
    def command(*args: Any, t_from: float, t_to: float | None, **rest: Any) -> Any:
        """Call the decorated command with ``window`` in place of ``t_from`` and ``t_to`` [s]; None: to the end."""
        window = TimeWindow(t_from, math.inf if t_to is None else t_to)
        try:
            window.check()
        except ValueError as error:
            raise click.UsageError(str(error), click.get_current_context()) from None
        return f(*args, window=window, **rest)

    seconds, of = FiniteRange(0.0), "[s of the log] of the interval of LOGS that is used."
    command = click.option("--to", "t_to", type=seconds, help=f"End {of}")(command)
    return click.option("--from", "t_from", type=seconds, default=0.0, help=f"Start {of}")(command)

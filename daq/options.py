"""Types of command-line options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, final

import click


@final
class FiniteRange(click.FloatRange):
    """Type of an option that takes finite numbers within bounds. The range of click would accept `nan`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the value of a command-line option as a number.

        A value that is not a finite number within the bounds of the option is a usage error.
        """
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


def view_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a command that records a log with the flag `--view`. The command receives it as `view`."""
    text = "Also serve the page of `seatrial view` for the browser of this computer. Its address is printed."
    return click.option("--view", is_flag=True, help=text)(command)

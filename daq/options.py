"""Types of options, shared by the command lines."""

from __future__ import annotations

import math
from typing import Any, final

import click


@final
class FiniteRange(click.FloatRange):
    """Finite numbers within bounds; click's own range takes `nan`, which is beyond no bound."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number. Fails, as wrong usage, where it is none, is not finite or is beyond a bound."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number

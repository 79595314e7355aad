"""Flag of an estimate: what is wrong with it, as a short code and in words."""

from __future__ import annotations

from typing import Literal

FlagCode = Literal[
    "at bound",
    "not determined",
    "prior",
    "larger error",
    "flat",
    "no robust error",
    "contradicted",
    "no mass",
    "ambiguous",
]


class Flag(str):
    """Flag of an estimate: a text for reports, which has a short code for tables and programs.

    It is a text wherever it is printed, compared or stored. A text that is made from it, for example by ``join``, has
    no code.

    Attributes
    ----------
    code
        Kind of the problem, such as ``at bound``.
    """

    code: FlagCode

    def __new__(cls, code: FlagCode, text: str) -> Flag:
        """Return the flag with this code and text."""
        flag = super().__new__(cls, text)
        flag.code = code
        return flag

    def __getnewargs__(self) -> tuple[FlagCode, str]:  # type: ignore[override]  # those of a text are the text alone
        """Return the arguments of `Flag` for pickle, with which fits go to other processes."""
        return self.code, str(self)

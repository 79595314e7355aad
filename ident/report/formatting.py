"""Formatting of numbers, units and channel names for reports: degrees, few digits, a true minus sign (U+2212)."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from seatrial.ident.results import EffectParameter

SUPER = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DEGREES = 180.0 / math.pi
LONGEST_FLAG = 48  # characters of a flag in the table of parameters; a longer one stands below it
STANDARD_GRAVITY = 9.80665  # m/s2 (CGPM 1901)
GRAMS_PER_NEWTON = 1000.0 / STANDARD_GRAVITY  # as data sheets of thrusters give their thrust
_RADIANS = re.compile(r"^(\(?)rad(\^?2|²)?(?![A-Za-z])")
_POWER = re.compile(r"(?<=[A-Za-z)])\^?(-?\d)")
MEANINGS = {
    "u": "surge speed",
    "v": "sway speed",
    "r": "yaw rate",
    "psi": "heading",
    "x": "position north",
    "y": "position east",
    "vx": "velocity north",
    "vy": "velocity east",
    "p": "roll rate",
    "q": "pitch rate",
    "phi": "roll",
    "theta": "pitch",
    "speed": "speed along the track",
    "ax": "surge specific force",
    "ay": "sway specific force",
    "az": "heave specific force",
    "X": "surge force",
    "Y": "sway force",
    "N": "yaw moment",
    "T": "relative change of thrust",
    "T_left": "relative change of thrust left",
    "T_right": "relative change of thrust right",
    "n_left": "shaft speed left",
    "n_right": "shaft speed right",
    "n_cmd_left": "command left",
    "n_cmd_right": "command right",
    "n_sum": "mean shaft speed",
    "n_diff": "difference of shaft speeds",
    "f_left": "thrust left",
    "f_right": "thrust right",
    "voltage_left": "voltage left",
    "voltage_right": "voltage right",
    "t": "time",
    "n": "shaft speed",
    "force": "force",
    "rpm": "shaft speed",
    "F": "force on the load cell",
    "n_dot": "acceleration of the shaft",
    "n_cmd": "command",
    "n_ref": "command after delay and dead zone",
    "slip": "command less shaft speed",
}
SYMBOLS = {"psi": "ψ", "phi": "φ", "theta": "θ"}


def degrees_for(unit: str) -> tuple[float, str]:
    """Return the factor from the unit of a result file to the unit that a report shows, and the shown unit.

    If the unit begins with rad or its square (rad, rad/s, rad2/Hz, (rad)^2/Hz), the shown unit has degrees and the
    factor is 180/pi, or its square for a square of rad. The factor of any other unit is 1, and the unit is only
    typeset: ``kg m2`` -> ``kg m²``.
    """
    found = _RADIANS.match(unit)
    if found is None:
        return 1.0, typeset_unit(unit)
    square = bool(found.group(2))
    shown = unit[: found.end(1)] + ("deg2" if square else "deg") + unit[found.end() :]
    return DEGREES**2 if square or unit.startswith("(rad)^2") else DEGREES, typeset_unit(shown)


def typeset_unit(unit: str) -> str:
    """Return a unit in typeset form: ``kg m2/s`` -> ``kg m²/s``, ``sqrt(s)`` -> ``√s``, ``N*m`` -> ``N·m``.

    The dimensionless units ``1`` and ``-`` become an empty text.
    """
    if unit.strip() in ("", "1", "-"):
        return ""
    roots = re.sub(r"sqrt\(([^()]+)\)", r"√\1", unit)
    return _POWER.sub(lambda m: m.group(1).translate(SUPER), roots).replace("*", "·")


def bracket(unit: str) -> str:
    """Return a unit in square brackets with a leading space, `` [deg/s]``, for an axis title; empty without a unit."""
    return f" [{unit}]" if unit else ""


def named(name: str) -> str:
    """Return meaning and symbol of a channel, input or force by its name: ``psi`` -> ``heading ψ``.

    The symbol is left out if it repeats the meaning. A name that is not in ``MEANINGS`` is returned unchanged.
    """
    meaning = MEANINGS.get(name)
    if not meaning or name in meaning.split() or name.replace("_", " ") == meaning:
        return meaning or name
    return f"{meaning} {SYMBOLS.get(name, name)}"


def symbol(name: str) -> str:
    """Return the symbol of a channel or input by its name: ``psi`` -> ``ψ``. Names without a symbol stay unchanged."""
    return SYMBOLS.get(name, name)


def titled(name: str) -> str:
    """Return meaning and symbol of a channel, input or force with a capital first letter: ``psi`` -> ``Heading ψ``.

    A name that is not in ``MEANINGS`` is returned unchanged.
    """
    words = named(name)
    return words[0].upper() + words[1:] if name in MEANINGS else name


def moment(created: str) -> str:
    """Return an ISO time (UTC) in readable form: ``2026-05-06T07:08:09+00:00`` -> ``2026-05-06 07:08:09 UTC``.

    Only ``T`` and ``+00:00`` are replaced; the text is not checked and may be empty.
    """
    return created.replace("T", " ").replace("+00:00", " UTC")


def tied(words: str) -> str:
    """Return a text with no-break spaces between numbers and their unit (such as m, s, N, deg), percent sign or ±.

    A browser then does not break the line there.
    """
    return re.sub(r"(?<=\d) (?=(%|ms?|s|N|kg|deg|Hz|V)\b|[%±])|(?<=±) (?=\d)", "\u00a0", words)


def count(value: float | None) -> str:
    """Return a count, for example of degrees of freedom, as text: ``12``; a dash for None.

    A number that is not whole keeps up to six significant digits.
    """
    return "–" if value is None else f"{value:g}"


def plain(value: float | None, digits: int = 3) -> str:
    """Return a number as text with ``digits`` significant digits; a dash if it is None or not finite.

    The minus sign is typographic. Zero is ``0``. Other absolute values that round to less than 1e-4, or to 1e6 or more,
    are written with a power of ten: ``1.2 ×10⁻⁶``.
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    size = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= size < 6:
        return f"{round(value, digits - 1 - size):.{max(digits - 1 - size, 0)}f}".replace("-", "−")
    return _scientific(value, size, digits - 1)


def with_error(value: float | None, se: float | None, unit: str = "") -> str:
    """Return a value with its standard error as text, ``40.05 ± 0.12 N``.

    Both have the decimals of two significant digits of the standard error. Without a positive standard error, the value
    has up to four significant digits, without trailing zeros, and no ±. If the larger of both is below 1e-4, or 1e6 or
    more, or if the standard error is below 1e-8, they have a common power of ten: ``(1.20 ± 0.15) ×10⁻⁶``.

    Parameters
    ----------
    value
        Estimate. If it is None, a dash takes its place; the unit still follows.
    se
        Standard error in the same unit, None if it is unknown.
    unit
        Unit, which follows the numbers; may be empty.
    """
    value_text, se_text = pair(value, se)
    joined = f"{value_text} ± {se_text}" if se_text else value_text
    if "×" in joined and se_text:
        joined = f"({joined.split(' ×')[0]} ± {se_text.split(' ×')[0]}) ×{joined.rsplit('×', 1)[1]}"
    return f"{joined} {unit}".strip()


def noise_level(value: float, se: float | None, limit: float | None, factor: float, unit: str = "") -> str:
    """Return the size of a noise in the shown unit with its standard error as text, or its upper limit.

    The upper limit, ``< 0.0021 deg``, is returned if there is a limit and no standard error: no noise was found. With
    neither, the text is the size alone.

    Parameters
    ----------
    value
        Standard deviation of white noise, or intensity of a random walk.
    se
        Standard error of the noise, None if no noise was found.
    limit
        95 % upper limit if no noise was found, otherwise None.
    factor
        Factor from the unit of the numbers to the shown unit.
    unit
        Shown unit, which follows the numbers; may be empty.
    """
    if se is None and limit is not None:
        return f"< {plain(factor * limit, 2)} {unit}".strip()
    return with_error(factor * value, None if se is None else factor * se, unit)


def pair(value: float | None, se: float | None) -> tuple[str, str]:
    """Return a value and its standard error as two texts with the same number of decimals.

    The decimals are those of two significant digits of the standard error. If the larger of both is below 1e-4, or 1e6
    or more, or if the standard error is below 1e-8, each has a power of ten, the same for both. If one of both is None
    or not finite, or if the standard error is not positive, the value has up to four significant digits (a dash for
    None), and the second text is empty.
    """
    if value is None or se is None or not (se > 0 and math.isfinite(value) and math.isfinite(se)):
        return short(plain(value, 4)), ""
    size = math.floor(math.log10(float(f"{se:.1e}")))
    top = max(math.floor(math.log10(abs(value))) if value else size, size)
    if -4 <= top < 6 and size >= -8:
        decimals = 1 - size
        shown, error = (f"{round(v, decimals):.{max(decimals, 0)}f}".replace("-", "−") for v in (value, se))
        return shown, error
    return _scientific(value, top, top - size + 1), _scientific(se, top, top - size + 1)


def short(number: str) -> str:
    """Return a decimal number without trailing zeros: ``0.4000`` -> ``0.4``. Other texts are returned unchanged.

    A minus sign must be typographic; a number with an ASCII minus sign is unchanged too.
    """
    return number.rstrip("0").rstrip(".") if re.fullmatch(r"−?\d+\.\d+", number) else number


def _scientific(value: float, size: int, decimals: int) -> str:
    """Return ``value`` as mantissa times ten to the power ``size``: ``1.2 ×10⁻⁶``.

    ``decimals`` are those of the mantissa; a negative number counts as 0.
    """
    return f"{value / 10.0**size:.{max(decimals, 0)}f} ×10{str(size).translate(SUPER)}".replace("-", "−")


def probability(p: float | None, level: float | None = None) -> str:
    """Return a p value as text with two decimals, or three below 0.1; a dash for None.

    It has as many decimals as show on which side of a ``level`` it is, if there is one: 0.0501 beside 0.05.

    Below 0.001 the text is the next larger power of ten: ``< 10⁻³``. Below 1e-300, zero included, it is ``< 10⁻³⁰⁰``.
    """
    if p is None:
        return "–"
    if p < 1e-300:  # near the smallest floating-point number, the value is no longer accurate
        return "< 10⁻³⁰⁰"
    if p < 1e-3:
        return f"< 10{str(math.floor(math.log10(p)) + 1).translate(SUPER)}"
    decimals = 3 if p < 0.1 else 2
    while level is not None and decimals < 15 and (round(p, decimals) <= level) != (p <= level):
        decimals += 1
    return f"{p:.{decimals}f}"


def p_equals(p: float) -> str:
    """Return a p value as text after the letter p: ``= 0.03`` or ``< 10⁻⁴``."""
    words = probability(p)
    return words if words.startswith("<") else f"= {words}"


def percent(share: float | None, digits: int = 0) -> str:
    """Return a share (1: all) as text in per cent with ``digits`` decimals: 0.34 -> ``34 %``; a dash for None."""
    if share is None:
        return "–"
    rounded = round(100 * share, digits) + 0.0  # turns -0.0 into 0.0
    return f"{rounded:.{digits}f} %".replace("-", "−")


def duration(seconds: float | None) -> str:
    """Return a duration [s] as text in hours, minutes and whole seconds: ``9 min 58 s``; a dash for None.

    Units with the number zero are left out. A duration of half a second or less has one decimal.
    """
    if seconds is None:
        return "–"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    parts = ((hours, "h"), (minutes, "min"), (rest, "s"))
    return " ".join(f"{n} {unit}" for n, unit in parts if n) or f"{seconds:.1f} s"


def estimate_of_effect(row: EffectParameter) -> str:
    """Return the estimate of a parameter of an effect with its standard error; a value at its bound is marked."""
    factor, unit = degrees_for(row.unit)
    value, se = scaled(factor, row.value, row.se)
    text = with_error(value, se, unit)
    return f"{text} (at its limit)" if row.at_bound else text


def scaled(factor: float, *values: float | None) -> list[float | None]:
    """Multiply each value by ``factor``, for example to convert it to the unit of a report. A value None is kept."""
    return [None if value is None else factor * value for value in values]

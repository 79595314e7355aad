"""Conversion of the plain formulas of effects to TeX: ``X -= d_uuu u^3`` to ``X \\leftarrow X - d_{uuu} \\, u^{3}``.

The formulas are written for the terminal. Words between the terms (``for n < 0``, ``e white``) stay upright text.
"""

from __future__ import annotations

import re

GREEK = ("beta", "chi", "delta", "kappa", "lambda", "omega", "psi", "rho", "tau", "zeta")
SYMBOLS = {"eps": r"\varepsilon"} | {name: rf"\{name}" for name in GREEK}
FUNCTIONS = {"sin": r"\sin", "cos": r"\cos", "tanh": r"\tanh", "exp": r"\exp", "max": r"\max", "sum": r"\sum"}
FUNCTIONS |= {"sgn": r"\operatorname{sgn}"}
OPERATORS = {"->": r"\leftarrow", ">=": r"\ge"} | {mark: mark for mark in "<>=+-/,"}
CHANGES = ("+=", "-=", "*=", "/=")  # a quantity is replaced by its sum with the right side, and so on
TOKEN = re.compile(
    r"(?P<text>[a-z]{2,}-[a-z]+)|(?P<name>[A-Za-z][A-Za-z0-9]*(?:_\w+)?)|(?P<number>\d+(?:\.\d+)?)"
    r"|(?P<mark>\+=|-=|\*=|/=|->|>=|[-+/<>=,()|^']|\s+)"
)
INDEX = re.compile(r"\w{1,2}|[uvrxyn]+|f\d[sc]")  # subscripts of single letters, such as uuu; others are words
DERIVATIVES = ("{}", r"\dot{{{}}}", r"\ddot{{{}}}")
TRANSPOSE = r"^{\top}"
NO_FACTORS = (*OPERATORS.values(), *FUNCTIONS.values(), "(", r"\left|", r"\,", r"\times")  # no end of a factor
Tokens = list[tuple[str, str]]


def formula_tex(formula: str) -> str | None:
    """Return a formula in TeX, for display.

    Parameters
    ----------
    formula : str
        Formula as in ``Effect.formula``. Semicolons, and commas before another relation, separate its parts.

    Returns
    -------
    str or None
        One line for each part, aligned if there are several. None if the formula has a character that no rule
        describes, or brackets or bars that do not match.
    """
    try:
        lines = [_part_tex(part) for part in _parts(formula)]
    except (ValueError, IndexError):
        return None
    if len(lines) == 1:
        return lines[0]
    return r"\begin{aligned} " + r" \\ ".join(f"& {line}" for line in lines) + r" \end{aligned}"


def _parts(formula: str) -> list[str]:
    """Split a formula at semicolons, and at commas outside brackets if a relation follows before the next comma."""
    found, depth, start = [], 0, 0
    for k, character in enumerate(formula):
        depth += (character == "(") - (character == ")")
        following = re.split(r"[,;]", formula[k + 1 :], maxsplit=1)[0]
        if depth == 0 and (character == ";" or (character == "," and re.search(r"[=<>]", following))):
            found.append(formula[start:k].strip())
            start = k + 1
    return [*found, formula[start:].strip()]


def _part_tex(part: str) -> str:
    """Return one part of a formula in TeX; ValueError if it cannot be read."""
    tokens: Tokens = []
    at = 0
    while at < len(part):
        match = TOKEN.match(part, at)
        if match is None:
            raise ValueError(part[at:])
        tokens.append((str(match.lastgroup), match[0]))
        at = match.end()
    return _joined(_changes_resolved(_with_text(tokens)))


def _is_word(text: str) -> bool:
    """Return whether a name is a word of English, not a quantity: all names of two or more letters without an index."""
    known = text in SYMBOLS or text in FUNCTIONS or text == "sqrt" or re.fullmatch(r"[A-Za-z]\d?", text)
    return not known and "_" not in text


def _with_text(tokens: Tokens) -> Tokens:
    """Merge runs of words to tokens of the kind ``text``, and mark the unit ``s`` and the cross product ``x``."""
    merged: Tokens = []
    for k, (kind, text) in enumerate(tokens):
        next_kind, following = next(((kind, t) for kind, t in tokens[k + 1 :] if t.strip()), ("", ""))
        before, _ = next(((kind, t) for kind, t in reversed(merged) if t.strip()), ("", ""))
        article = text == "a" and not merged and next_kind == "name" and _is_word(following)
        noun = text == "sum" and following not in ("|", "(")
        between = before in ("name", "number") and (next_kind == "name" or following == "(")
        if kind == "name" and text == "s" and before == "number":
            merged.append(("unit", text))
        elif text == "x" and between:
            merged.append(("mark", "x"))  # a cross product
        elif kind == "name" and (_is_word(text) or article or noun):
            merged.append(("text", text))
        else:
            merged.append((kind, text))
    joined: Tokens = []
    for kind, text in merged:
        if kind == "text" and len(joined) > 1 and not joined[-1][1].strip() and joined[-2][0] == "text":
            joined.pop()
            joined[-1] = ("text", f"{joined[-1][1]} {text}")
        else:
            joined.append((kind, text))
    return joined


def _changes_resolved(tokens: Tokens) -> Tokens:
    """Write ``X -= a + b`` as ``X -> X - (a + b)``, and the other operators that change a quantity likewise.

    The right side ends before the first text, or the first comma outside brackets.
    """
    at = next((k for k, (_, text) in enumerate(tokens) if text in CHANGES), None)
    if at is None:
        return tokens
    left, operator, depth, end, is_sum = tokens[:at], tokens[at][1][0], 0, at + 1, False
    while end < len(tokens):
        kind, text = tokens[end]
        if kind == "text" or (depth == 0 and text == ","):
            break
        depth += (text == "(") - (text == ")")
        is_sum |= depth == 0 and text in ("+", "-")
        end += 1
    right = [*tokens[at + 1 : end]]
    while right and not right[0][1].strip():
        right.pop(0)
    while right and not right[-1][1].strip():
        right.pop()
    if (is_sum and operator != "+") or (operator == "/" and len(right) > 1):
        right = [("mark", "("), *right, ("mark", ")")]
    sign: Tokens = [] if operator == "*" else [("mark", operator), ("mark", " ")]
    return [*left, ("mark", "->"), ("mark", " "), *left, *sign, *right, ("mark", " "), *tokens[end:]]


def _joined(tokens: Tokens) -> str:
    """Return tokens in TeX. A thin space separates factors that the formula separates by a space."""
    out: list[str] = []
    brackets: list[str] = []
    k, space = 0, False
    while k < len(tokens):
        kind, text = tokens[k]
        if not text.strip():
            space = True
            k += 1
            continue
        factor = kind in ("name", "number") or text == "(" or (text == "|" and "|" not in brackets)
        if space and factor and out and _ends_factor(out[-1]):
            out.append(r"\,")
        space = False
        if kind == "text":
            after = "" if all(not t.strip() or t == "," for _, t in tokens[k + 1 : k + 3]) else " "
            out.append(rf"\text{{{' ' if out else ''}{text}{after}}}")
        elif kind == "unit":
            out.append(rf"\,\mathrm{{{text}}}")
        elif text == "x" and kind == "mark":
            out.append(r"\times")
        elif kind == "name" and text == "sqrt":
            inner, k = _bracket(tokens, k + 1)
            out.append(rf"\sqrt{{{_joined(inner)}}}")
        elif kind == "name":
            primes = next((n for n, (_, t) in enumerate(tokens[k + 1 :]) if t != "'"), len(tokens) - k - 1)
            out.append(_name(text, primes))
            k += primes
        elif text == "^":
            if tokens[k + 1][1] == "(":
                inner, k = _bracket(tokens, k + 1)
                out.append(f"^{{{_joined(inner)}}}")
            else:
                k += 1
                out.append(f"^{{{_name(tokens[k][1])}}}")
        elif text == "'":
            out.append(TRANSPOSE)
        elif text == "(":
            brackets.append("(")
            out.append("(")
        elif text == ")":
            if not brackets or brackets.pop() != "(":
                raise ValueError("bracket")
            out.append(")")
        elif text == "|":
            closes = bool(brackets) and brackets[-1] == "|"
            brackets.pop() if closes else brackets.append("|")
            out.append(r"\right|" if closes else r"\left|")
        else:
            out.append(OPERATORS.get(text, text))
        k += 1
    if brackets:
        raise ValueError("bracket")
    return re.sub(r" (?=[\^'_,])", "", " ".join(out)).replace("( ", "(").replace(" )", ")").strip()


def _ends_factor(tex: str) -> bool:
    """Return whether a piece of TeX ends a factor, so that a following one is a product."""
    return tex not in (
        *OPERATORS.values(),
        *FUNCTIONS.values(),
        "(",
        r"\lvert",
        r"\,",
        r"\times",
    ) and not tex.startswith(r"\text")


def _bracket(tokens: Tokens, start: int) -> tuple[Tokens, int]:
    """Return the tokens in the bracket that begins at ``start``, and the index of its end; ValueError without one."""
    if start >= len(tokens) or tokens[start][1] != "(":
        raise ValueError("bracket")
    depth = 0
    for k in range(start, len(tokens)):
        depth += (tokens[k][1] == "(") - (tokens[k][1] == ")")
        if depth == 0:
            return tokens[start + 1 : k], k
    raise ValueError("bracket")


def _name(text: str, primes: int = 0) -> str:
    """Return a name or a number in TeX, with its index as a subscript.

    One or two primes are derivatives with respect to time, written as dots. One prime of a rotation matrix R is its
    transpose.
    """
    if text in FUNCTIONS:
        return FUNCTIONS[text]
    base, _, index = text.partition("_")
    if not index and (numbered := re.fullmatch(r"([A-Za-z])(\d)", base)):
        base, index = numbered[1], numbered[2]
    shown = SYMBOLS.get(base, base if len(base) == 1 or base.replace(".", "").isdigit() else rf"\mathrm{{{base}}}")
    transposed = TRANSPOSE if base == "R" and primes else ""
    if not transposed:
        shown = DERIVATIVES[primes].format(shown)
    if not index:
        return f"{shown}{transposed}"
    words = rf"\mathrm{{{index}}}"
    return f"{shown}_{{{SYMBOLS.get(index, index if INDEX.fullmatch(index) else words)}}}{transposed}"

"""Export to ROS 2: a parameter file of a node with names, parameters, standard errors and noise; no equations."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence

from seatrial.ident.export.codegen import Content, comment, header


def write(c: Content) -> str:
    """Return the text of the YAML file; empty lists are left out, as ROS 2 cannot infer their type."""
    own = [p.name for p in c.own]
    units = {n: p.unit for n, p in zip(c.parameters, c.own, strict=True)}
    errors = {n: e for n, e in zip(c.parameters, c.errors, strict=True) if math.isfinite(e)}
    rows = [f"model: {_text(c.model.name)}"]
    if c.model.effects:
        rows.append(f"effects: {_texts(e.name for e in c.model.effects)}")
    for kind, names, part in (
        ("state", c.states, c.model.states),
        ("input", c.inputs, c.model.inputs),
        ("output", c.outputs, c.model.outputs),
    ):
        if names:
            rows += [f"{kind}s: {_texts(names)}", f"{kind}_units: {_texts(signal.unit for signal in part)}"]
    if c.angles:
        rows.append(f"angles: {_texts(c.angles)}")
    if own:
        comments = [comment(c, i) for i in range(len(own))]
        rows += [
            "parameters:",
            *(f"  {_key(n)}: {_number(v)}  # {s}" for n, v, s in zip(c.parameters, c.values, comments, strict=True)),
        ]
        rows += ["units:", *(f"  {_key(n)}: {_text(unit)}" for n, unit in units.items())]
    rows += _group("standard_errors", errors)
    rows += _group("process_noise", dict(zip(c.states, c.state_noise, strict=True)), "diffusion, unit/sqrt(s)")
    rows += _group("measurement_noise", dict(zip(c.outputs, c.output_noise, strict=True)), "standard deviation, unit")
    if c.validity:
        rows.append("validity:")
        rows += [f"  {_key(n)}: [{_number(low)}, {_number(high)}]" for n, (low, high) in c.validity.items()]
    top = ["# " + line if line else "#" for line in header(c, "ROS 2 (parameters of a node)")]
    return "\n".join([*top, f"{c.name}:", "  ros__parameters:", *("    " + row for row in rows), ""])


def _group(name: str, values: Mapping[str, float], remark: str = "") -> list[str]:
    """Return the lines of a mapping with an optional comment; no lines for an empty mapping."""
    if not values:
        return []
    return [
        f"{name}:" + (f"  # {remark}" if remark else ""),
        *(f"  {_key(n)}: {_number(v)}" for n, v in values.items()),
    ]


def _number(value: float) -> str:
    """Return a number with a decimal point: YAML reads ``1e-05`` as a text, and ROS 2 reads ``35`` as an integer."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def _key(name: str) -> str:
    """Return a key, quoted if YAML 1.1 would read it as a truth value (``y``, ``N``)."""
    return _text(name) if name.lower() in ("y", "n", "yes", "no", "on", "off", "true", "false", "null") else name


def _text(words: str) -> str:
    return json.dumps(words, ensure_ascii=False)


def _texts(items: Iterable[str] | Sequence[str]) -> str:
    return f"[{', '.join(_text(item) for item in items)}]"

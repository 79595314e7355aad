"""Export to ROS 2: a parameter file of a node with names, parameters, standard errors and noise; no equations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

from seatrial.ident.data import TIME_INPUT, WORK_INPUT
from seatrial.ident.export.codegen import Content, comment, header
from seatrial.ident.export.history import TIME, WORK


def write(content: Content) -> str:
    """Return the text of the YAML file of a model, with the parameters of a ROS 2 node.

    Empty lists are left out, because ROS 2 cannot infer their type. Parameters without a standard error, and
    relative ones, are left out of ``standard_errors``. The name of the node is the prefix of the content.
    """
    own = [p.name for p in content.exported_parameters]
    units = {n: content.parameter_unit(i) for i, n in enumerate(content.parameters)}
    rows = [f"model: {_quoted(content.model.name)}"]
    if content.effects:
        rows.append(f"effects: {_quoted_list(content.effects)}")
    for kind, names, part in (
        ("state", content.states, content.model.states),
        ("output", content.outputs, content.model.outputs),
    ):
        if names:
            rows += [
                f"{kind}s: {_quoted_list(names)}",
                f"{kind}_units: {_quoted_list(content.unit(signal.unit) for signal in part)}",
            ]
    past = content.history
    if past.inputs:
        rows += [
            "# A node gives only the physical inputs.",
            f"physical_inputs: {_quoted_list(content.physical_inputs)}",
            f"physical_input_units: {_quoted_list(content.unit(i.unit) for i in past.inputs)}",
            f"physical_input_holds: {_quoted_list(content.holds)}",
        ]
    if past.sources:
        rows += [
            "# The inputs of the equations follow from them: input k is input_sources[k] of input_delays[k] seconds",
            "# ago. Without a past, it is the present value.",
            f"inputs: {_quoted_list(content.inputs)}",
            f"input_units: {_quoted_list(content.unit(i.unit) for i in content.model.inputs)}",
        ]
        sources = [{TIME: TIME_INPUT, WORK: WORK_INPUT}.get(k) or content.physical_inputs[k] for k in past.sources]
        rows += [
            f"input_sources: {_quoted_list(sources)}",
            f"input_delays: [{', '.join(map(_number_text, past.delays))}]  # of each input behind its source, s",
        ]
    for source, name, value in zip((TIME, WORK), (TIME_INPUT, WORK_INPUT), content.late, strict=True):
        if source in past.sources:
            rows.append(f"default_{name}: {_number_text(value)}  # of the input {name}: the end of the fitted data")
    rows.append(f"max_step: {_number_text(past.max_step)}  # of the integration, s")
    if content.angles:
        rows.append(f"angles: {_quoted_list(content.angles)}")
    if own:
        comments = [comment(content, i) for i in range(len(own))]
        rows += [
            "parameters:",
            *(
                f"  {_yaml_key(n)}: {_number_text(v)}  # {s}"
                for n, v, s in zip(content.parameters, content.values, comments, strict=True)
            ),
        ]
        rows += ["units:", *(f"  {_yaml_key(n)}: {_quoted(unit)}" for n, unit in units.items())]
    rows += _mapping_lines("standard_errors", content.standard_errors)
    rows += _mapping_lines(
        "process_noise", dict(zip(content.states, content.state_noise, strict=True)), "diffusion, unit/sqrt(s)"
    )
    rows += _mapping_lines(
        "measurement_noise", dict(zip(content.outputs, content.output_noise, strict=True)), "standard deviation, unit"
    )
    if content.validity:
        rows.append("validity:  # 98 % of the velocities u, v, r, and all inputs of the estimation data")
        rows += [
            f"  {_yaml_key(n)}: [{_number_text(low)}, {_number_text(high)}]"
            for n, (low, high) in content.validity.items()
        ]
    top = ["# " + line if line else "#" for line in header(content, "ROS 2 (parameters of a node)", "The node")]
    return "\n".join([*top, f"{content.name}:", "  ros__parameters:", *("    " + row for row in rows), ""])


def _mapping_lines(name: str, values: Mapping[str, float], remark: str = "") -> list[str]:
    """Return the YAML lines of a mapping of numbers: its name with an optional comment, then its indented entries.

    There are no lines for an empty mapping.
    """
    if not values:
        return []
    return [
        f"{name}:" + (f"  # {remark}" if remark else ""),
        *(f"  {_yaml_key(n)}: {_number_text(v)}" for n, v in values.items()),
    ]


def _number_text(value: float) -> str:
    """Return a number as YAML text with a decimal point.

    YAML reads ``1e-05`` as a text, and ROS 2 reads ``35`` as an integer. The value must be finite.
    """
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def _yaml_key(name: str) -> str:
    """Return a YAML key, quoted if YAML 1.1 would read it as a truth value or null (``y``, ``N``, ``null``)."""
    return _quoted(name) if name.lower() in ("y", "n", "yes", "no", "on", "off", "true", "false", "null") else name


def _quoted(words: str) -> str:
    """Return a text in double quotes, as YAML reads it; quotes and control characters are escaped as in JSON."""
    return json.dumps(words, ensure_ascii=False)


def _quoted_list(items: Iterable[str] | Sequence[str]) -> str:
    """Return a YAML list of quoted texts in one line."""
    return f"[{', '.join(_quoted(item) for item in items)}]"

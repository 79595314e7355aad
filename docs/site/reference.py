"""Generator of docs/reference.md, the reference of the Python interface: ``python docs/site/reference.py``.

The names come from ``seatrial.__all__``, and the texts are their docstrings.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
# Before the import of the project: the page must describe the tree of this file, not an installed package.
sys.path.insert(0, str(ROOT))

import click  # noqa: E402

import seatrial  # noqa: E402
from seatrial import command_line  # noqa: E402
from seatrial.api.messages import ARGUMENTS, FUNCTIONS  # noqa: E402

PAGE = ROOT / "docs/reference.md"
OPTIONS = tuple(getattr(seatrial, f"{name}Options") for name in ("Fit", "Diagnosis", "Thruster", "Design", "Export"))
HEAD = """# Reference of the Python interface

<!-- written by python docs/site/reference.py -->

`import seatrial as st` gives these names. [Use seatrial in Python](how-to/python.md) shows them in use. Numbers are in
SI units and radians. Other modules of the package are internal and may change without notice.

"""
# Arguments by function and option that no table of the package has.
SPECIAL = {
    ("st.design", "--json"): "",
    ("st.export", "--to"): "format", ("st.export", "--format"): "format", ("st.export", "--out"): "folder",
}  # fmt: skip
# What an option becomes in Python if it is no argument of the function.
OUTSIDE = {
    "--from": "st.open_log(log, start=)", "--to": "st.open_log(log, end=)", "--out": ".save(folder)",
    "--json": ".result",
}  # fmt: skip
WIDTH = 120  # columns of a line of code
LISTS = ("Parameters", "Attributes", "Returns", "Raises", "Warns", "Yields")  # sections of a docstring that are lists


def main() -> int:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written: {PAGE.relative_to(ROOT)}")
    return 0


def page() -> str:
    """Return the text of the page: functions, then their options, classes and errors."""
    things = {name: getattr(seatrial, name) for name in sorted(seatrial.__all__)}
    functions = {n: x for n, x in things.items() if inspect.isfunction(x)}
    options = {x.__name__: x for x in OPTIONS}
    classes = {n: x for n, x in things.items() if inspect.isclass(x) and n not in options}
    parts = [HEAD, "## Functions\n\n", *(entry(f"st.{n}", x) for n, x in functions.items())]
    parts += ["## Options\n\n", *(entry(f"st.{n}", x) for n, x in options.items())]
    parts += ["## Options with another name on the command line\n\n", option_table()]
    errors = {n: classes.pop(n) for n in tuple(classes) if issubclass(classes[n], Exception)}
    parts += ["## Results\n\n", *(entry(n, x) for n, x in classes.items())]
    parts += ["## Errors and warnings\n\n", *(entry(f"st.{n}", x) for n, x in errors.items())]
    return "".join(parts).rstrip() + "\n"


def option_table() -> str:
    """Return the table of the options of commands that have another name in Python.

    The commands of a rig (`check`) and second names of an option (``--output``) are left out.
    """
    rows: dict[tuple[str, str], list[str]] = {}
    for function, option, argument in option_names():
        if (
            argument
            and function != "st.check"
            and option != "--output"
            and argument != option.removeprefix("--").replace("-", "_")
        ):
            rows.setdefault((option, argument), []).append(function)
    text = (
        "Other options have the same name in Python, with `_` in place of `-` (`--max-effects`: `max_effects`), or "
        "belong\nto the command line alone (`--trust-code`).\n\n"
    )
    text += "| command line | Python | of |\n|---|---|---|\n"
    for (option, argument), functions in sorted(rows.items()):
        text += f"| `{option}` | `{argument}` | {', '.join(f'`{f}`' for f in functions)} |\n"
    return text + "\n"


def option_names() -> Iterator[tuple[str, str, str]]:
    """Yield for each option of a command with a function in Python: function, option, and argument of the function.

    The argument is empty if there is none. The names are those of the commands and of the signatures.
    """
    for words, function in FUNCTIONS.items():
        command: Any = command_line.cli
        for word in words.split()[1:]:
            command = command.get_command(click.Context(command), word)
        thing = getattr(seatrial, function.removeprefix("st."))
        known = set(inspect.signature(thing).parameters)
        hints = inspect.signature(thing).parameters.get("options")
        own = [] if hints is None else [x for x in OPTIONS if x.__name__ in str(hints.annotation)]
        known |= {name for x in own for name in x.__annotations__}
        for p in command.params:
            if isinstance(p, click.Option) and p.name != "help":
                for option in (o for o in (*p.opts, *p.secondary_opts) if o.startswith("--")):
                    yield function, option, argument_of(function, p, option, known)


def argument_of(function: str, p: click.Option, option: str, known: Collection[str]) -> str:
    """Return the argument of a function in Python for an option of its command; empty if there is none.

    ``known`` are the names of its arguments. A choice between two options is shown with its value, such as
    ``mean_order=2``.
    """
    if (function, option) in SPECIAL:
        return SPECIAL[function, option]
    if p.name in known and not p.secondary_opts:
        return str(p.name)
    if option in ARGUMENTS and ARGUMENTS[option].partition("=")[0] in known:
        return ARGUMENTS[option]
    if p.name in known:
        return str(p.name) if option[2:].replace("-", "_") == p.name else f"{p.name}={option in p.opts}"
    return OUTSIDE.get(option, "")


def entry(name: str, thing: Any) -> str:
    """Return heading, signature and docstring of a name; for a class also its properties and methods."""
    text = f"### {name}\n\n"
    if inspect.isfunction(thing):
        text += f"```python\n{signature(name, thing)}\n```\n\n"
    text += docstring(inspect.getdoc(thing) or "")
    if inspect.isclass(thing):
        for base in reversed(thing.__mro__):
            if base.__module__.startswith("seatrial."):
                for member, value in vars(base).items():
                    if not member.startswith("_") and vars(thing).get(member, value) is value:
                        text += member_entry(member, value)
    return text


def member_entry(name: str, value: Any) -> str:
    """Return the text of a property or a method; empty for other members."""
    if isinstance(value, property):
        return f"**{name}**: {docstring(inspect.getdoc(value) or '')}"
    if inspect.isfunction(value):
        return f"```python\n{signature(name, value)}\n```\n\n{docstring(inspect.getdoc(value) or '')}"
    return ""


def signature(name: str, function: Any) -> str:
    """Return name and parameters of a function, without types, with the line breaks of the formatter."""
    parameters = [
        p.replace(annotation=inspect.Parameter.empty) for p in inspect.signature(function).parameters.values()
    ]
    # With the quotes of the formatter, which also formats the code blocks of pages.
    shown = [str(p).replace("'", '"') for p in parameters if p.name != "self"]
    line = f"{name}({', '.join(shown)})"
    if len(line) <= WIDTH:
        return line
    inside = f"    {', '.join(shown)}"
    if len(inside) > WIDTH:  # one on each line, with a comma after the last one
        inside = "\n".join(f"    {word}," for word in shown)
    return f"{name}(\n{inside}\n)"


def docstring(text: str) -> str:
    """Return a docstring in the form of numpydoc as Markdown: sections become bold, fields become lists."""
    lines, found, section = text.splitlines(), list[str](), ""
    k = 0
    while k < len(lines):
        line = lines[k]
        if k + 1 < len(lines) and set(lines[k + 1]) == {"-"} and line.strip():
            section = line
            found += ["", f"**{section}**", ""]
            k += 2
            continue
        if section == "Examples":
            found.append(f"    {line}" if line else "")
        elif section in LISTS and line and not line.startswith(" "):
            name, colon, kind = line.partition(" : ")
            found.append(f"- `{name}`" + (f" ({kind})" if colon else "") + ":")
        elif section and line.startswith("    "):
            found.append(f"  {line.strip()}")
        else:
            found.append(line)
        k += 1
    markdown = re.sub(r"``([^`]+)``", r"`\1`", "\n".join(found)).replace(" |", " \\|")
    return re.sub(r"\n{3,}", "\n\n", markdown).strip() + "\n\n"


if __name__ == "__main__":
    sys.exit(main())

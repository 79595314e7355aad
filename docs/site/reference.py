"""Generator of docs/reference.md, the reference of the Python interface: ``python docs/site/reference.py``.

The names come from ``seatrial.__all__``, and the texts are their docstrings.
"""

from __future__ import annotations

import inspect
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
# Before the import of the project: the page must describe the tree of this file, not an installed package.
sys.path.insert(0, str(ROOT))

import seatrial  # noqa: E402
from seatrial.api import fits, loading, runs  # noqa: E402

PAGE = ROOT / "docs/reference.md"
OPTIONS = (fits.FitOptions, fits.DiagnosisOptions, runs.ThrusterOptions, runs.DesignOptions, loading.ExportOptions)
HEAD = """# Reference of the Python interface

<!-- written by python docs/site/reference.py -->

`import seatrial as st` gives these names. [Use seatrial in Python](how-to/python.md) shows them in use. Numbers are in
SI units and radians. Other modules of the package are internal and may change without notice.

"""
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
    classes = {n: x for n, x in things.items() if inspect.isclass(x)}
    parts = [HEAD, "## Functions\n\n", *(entry(f"st.{n}", x) for n, x in functions.items())]
    parts += ["## Options\n\n", *(entry(n, x) for n, x in options.items())]
    errors = {n: classes.pop(n) for n in tuple(classes) if issubclass(classes[n], Exception)}
    parts += ["## Results\n\n", *(entry(n, x) for n, x in classes.items())]
    parts += ["## Errors and warnings\n\n", *(entry(f"st.{n}", x) for n, x in errors.items())]
    return "".join(parts).rstrip() + "\n"


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

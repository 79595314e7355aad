"""Generator of the picture and the tables in docs/architecture.md: ``python docs/site/architecture.py``.

The content comes from the import contracts in pyproject.toml, which `make lint` checks. An import is allowed if no
contract forbids it.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/architecture.md"
PICTURE = ROOT / "docs/pictures/architecture.svg"
BEGIN, END = "<!-- contracts: python docs/site/architecture.py -->", "<!-- end -->"
PARTS = ("seatrial", "bench", "ident", "mocks", "daq")
VERBS = {"seatrial": "the commands", "bench": "excite", "ident": "explain", "mocks": "simulate", "daq": "measure"}
# Boxes in the picture: x and y of the upper left corner, width.
BOXES = {
    "seatrial": (20, 20, 720),
    "bench": (20, 170, 200),
    "ident": (280, 170, 200),
    "mocks": (540, 170, 200),
    "daq": (20, 350, 720),
}
HEIGHT = 56
BLUE, ORANGE, INK = "#0072b2", "#d55e00", "#1b1f24"


class Arrow(NamedTuple):
    """Permission of one part to import another part."""

    source: str
    target: str
    only: tuple[str, ...]  # modules of `target` that `source` may import; empty if it may import all of them


class Kept(NamedTuple):
    """Library that the contracts forbid in some parts."""

    library: str
    out_of: tuple[str, ...]  # parts that must not import the library
    but: tuple[str, ...]  # modules in these parts that may import the library


def contracts() -> list[dict[str, Any]]:
    """Return the contracts of pyproject.toml. Modules have the names of the folders, without `seatrial.`."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    rules = table["tool"]["importlinter"]["contracts"]
    return [{key: _short(value) if key != "name" else value for key, value in rule.items()} for rule in rules]


def _short(value: Any) -> Any:
    """Return a value of a contract with names of folders instead of names of modules."""
    if isinstance(value, list):
        return [_short(item) for item in value]
    if isinstance(value, str):
        return value.replace("seatrial.command_line", "seatrial").replace("seatrial.", "")
    return value


def file_of(module: str) -> Path:
    """Return the path of a module, without its suffix, relative to the project."""
    return Path(*module.removeprefix("seatrial.").split("."))


def forbidding(rules: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the contracts that forbid imports, without those that order the layers of a part."""
    return [rule for rule in rules if "forbidden_modules" in rule]


def arrows(rules: list[dict[str, Any]]) -> list[Arrow]:
    """Return the allowed imports between parts, in the order of the boxes."""
    found = []
    for source in PARTS:
        for target in PARTS:
            if source == target or target == "seatrial":
                continue
            only: tuple[str, ...] | None = ()
            for rule in forbidding(rules):
                if source in rule["source_modules"] and target in rule["forbidden_modules"]:
                    only = _exceptions(rule, target) or None
            if only is not None:
                found.append(Arrow(source, target, only))
    return found


def _exceptions(rule: dict[str, Any], target: str) -> tuple[str, ...]:
    """Return the modules of `target` that a rule exempts from its prohibition."""
    right = {line.partition("->")[2].strip().removesuffix(".**") for line in rule.get("ignore_imports", ())}
    return tuple(sorted(module for module in right if module.partition(".")[0] == target))


def kept(rules: list[dict[str, Any]]) -> list[Kept]:
    """Return the libraries in the contracts, sorted by name."""
    found = []
    for rule in forbidding(rules):
        for library in rule["forbidden_modules"]:
            if library in PARTS:
                continue
            left = {line.partition("->")[0].strip() for line in rule.get("ignore_imports", ()) if library in line}
            but = tuple(sorted({module.removesuffix(".**") for module in left}))
            found.append(Kept(library, tuple(rule["source_modules"]), but))
    return sorted(found)


def tables() -> str:
    """Return the tables of the page in Markdown: the contracts, the layers of each part, and the workflows."""
    rules = contracts()
    lines = ["| part | may import |", "|---|---|"]
    for part in PARTS:
        own = [arrow for arrow in arrows(rules) if arrow.source == part]
        targets = [", ".join(f"`{module}`" for module in arrow.only) or f"all of `{arrow.target}`" for arrow in own]
        lines.append(f"| `{part}` | {'; '.join(targets) or 'no other part'} |")
    lines += ["", "| library | not allowed in | except in |", "|---|---|---|"]
    for library, out_of, but in kept(rules):
        names = ", ".join(f"`{part}`" for part in out_of)
        lines.append(f"| {library} | {names} | {', '.join(f'`{module}`' for module in but) or '-'} |")
    return "\n".join([*lines, *layer_tables(rules), *paths()])


WORKFLOWS = {
    "seatrial ident vehicle": ("seatrial.ident.workflows.vehicle", "vehicle"),
    "seatrial ident diagnose": ("seatrial.ident.workflows.diagnose", "diagnosis"),
}


class Step(NamedTuple):
    """Call of a workflow into another module."""

    module: str
    name: str  # of the called function or class


def call_path(module: str, function: str) -> list[Step]:
    """Return the calls of a workflow into other modules of ident, in the order of their evaluation.

    Functions of the workflow's own file are followed. A name that is imported from a package is assigned to the module
    that defines it, according to the package's `__init__.pyi`.

    Parameters
    ----------
    module : str
        Module of the workflow.
    function : str
        Function of the workflow in this module.
    """
    tree = ast.parse((ROOT / file_of(module)).with_suffix(".py").read_text(encoding="utf-8"))
    where: dict[str, str] = {}
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("seatrial.ident."):
            stub = ROOT / file_of(node.module or "") / "__init__.pyi"
            public = ast.parse(stub.read_text(encoding="utf-8")).body if stub.exists() else []
            home = {
                a.name: f"{node.module}.{n.module}" for n in public if isinstance(n, ast.ImportFrom) for a in n.names
            }
            where |= {a.asname or a.name: home.get(a.name, node.module or "") for a in node.names}
    own = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
    found: list[Step] = []

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):  # arguments are evaluated before the call
            visit(child)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            name = node.func.id
            if name in own and name != function:
                body(name)
            elif name in where:
                found.append(Step(where[name], name))

    def body(name: str) -> None:
        for statement in own[name].body:
            visit(statement)

    body(function)
    return found


def paths() -> list[str]:
    """Return one table for each workflow, with its calls from the log to the result."""
    lines = [
        "",
        "### From log to result",
        "",
        "The tables list the files in the order in which the command calls them. No file is called again later "
        "(`tests/test_house.py`).",
    ]
    for command, (module, function) in WORKFLOWS.items():
        lines += [
            "",
            f"`{command}`, `{module}.{function}`:",
            "",
            "| file | called functions and classes |",
            "|---|---|",
        ]
        steps = call_path(module, function)
        for home in dict.fromkeys(step.module for step in steps):
            names = dict.fromkeys(f"`{step.name}`" for step in steps if step.module == home)
            lines.append(f"| `{file_of(home).as_posix()}.py` | {', '.join(names)} |")
    return lines


def layer_tables(rules: list[dict[str, Any]]) -> list[str]:
    """Return one table for each part, with its folders and files from the lowest layer up and their docstrings."""
    lines = ["", "## Folders and files"]
    for rule in rules:
        if rule["type"] != "layers":
            continue
        (part,) = rule["containers"]
        lines += ["", f"### {part}", "", "| folder or file | content |", "|---|---|"]
        for layer in reversed(rule["layers"]):
            for name in re.split(r" [|:] ", layer):
                folder, file = ROOT / part / name / "__init__.py", ROOT / part / f"{name}.py"
                tree = ast.parse((folder if folder.exists() else file).read_text(encoding="utf-8"))
                first = (ast.get_docstring(tree) or "").partition("\n\n")[0].replace("\n", " ")
                place = f"{part}/{name}/" if folder.exists() else f"{part}/{name}.py"
                lines.append(f"| `{place}` | {first.replace('|', chr(92) + '|')} |")
    return lines


def svg() -> str:
    """Return the picture: one box for each part and one arrow for each allowed import.

    An arrow is dashed if only some modules may be imported.
    """
    width, height = 760, BOXES["daq"][1] + HEIGHT + 20
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" role="img">',
        "<title>Who may import whom</title>",
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for colour, name in ((BLUE, "all"), (ORANGE, "some")):
        parts.append(
            f'<marker id="{name}" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
            f'<path d="M0 0 8 4 0 8z" fill="{colour}"/></marker>'
        )
    parts += [_arrow(arrow) for arrow in arrows(contracts())]
    parts += [_box(part) for part in PARTS]
    return "\n".join([*parts, "</svg>"]) + "\n"


def _box(part: str) -> str:
    """Return the box of a part in SVG, with its name and its task."""
    x, y, width = BOXES[part]
    middle = x + width / 2
    title = f"{part}/"
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{HEIGHT}" rx="8" fill="#eef3f7" stroke="{INK}"/>'
        f'<text x="{middle:g}" y="{y + 24}" text-anchor="middle" font-size="17" fill="{INK}">{title}</text>'
        f'<text x="{middle:g}" y="{y + 43}" text-anchor="middle" font-size="13" fill="#4a5560">{VERBS[part]}</text>'
    )


def _arrow(arrow: Arrow) -> str:
    """Return an arrow in SVG, from the lower edge of the source's box to the upper edge of the target's box."""
    x0, y0, w0 = BOXES[arrow.source]
    x1, y1, w1 = BOXES[arrow.target]
    # The arrow from the top row to the bottom row passes between two boxes of the middle row.
    passes_middle_row = arrow.source == "seatrial" and arrow.target == "daq"
    x = 250.0 if passes_middle_row else (x0 if w0 < w1 else x1) + min(w0, w1) / 2
    style, end = (BLUE, "all") if not arrow.only else (ORANGE, "some")
    dash = ' stroke-dasharray="6 4"' if arrow.only else ""
    line = (
        f'<line x1="{x:g}" y1="{y0 + HEIGHT}" x2="{x:g}" y2="{y1 - 2}" stroke="{style}" stroke-width="2"{dash} '
        f'marker-end="url(#{end})"/>'
    )
    words = [module.partition(".")[2] for module in arrow.only]
    if not words:
        return line
    start = (y0 + HEIGHT + y1) / 2 - 8 * len(words) + 10
    return line + "".join(
        f'<text x="{x + 10:g}" y="{start + 16 * k:g}" font-size="13" fill="{INK}">{escape(word)}</text>'
        for k, word in enumerate(words)
    )


def page(text: str) -> str:
    """Return the page with new tables between its marks."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{tables()}\n\n{END}{after}"


def main() -> int:
    """Write the picture and the page."""
    PICTURE.write_text(svg(), encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(f"written: {PICTURE.relative_to(ROOT)}, {PAGE.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

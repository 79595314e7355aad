"""Tests of docs/troubleshooting.md: the code contains each quoted line, and the page misses hardly an error.

A message is compared as a template: values that the code fills in are written as … in both.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/troubleshooting.md"
PARTS = ("daq", "bench", "ident", "mocks")
GAP = "…"
END = "\0"  # between the texts of the code
# Up to a tenth of the errors may be missing, because new errors can be added before their line in the page.
LEAST_TOLD = 0.9


def templates(node: ast.expr) -> Iterator[str]:
    """Return the texts that an expression can produce, with … for values that are filled in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(p.value if isinstance(p, ast.Constant) else GAP for p in node.values)  # type: ignore[misc]
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        yield from (a + b for a in templates(node.left) for b in templates(node.right))
    elif isinstance(node, ast.IfExp):
        yield from (*templates(node.body), *templates(node.orelse))
    else:
        yield GAP


def sources() -> list[Path]:
    parts = (path for part in PARTS for path in sorted((ROOT / part).rglob("*.py")))
    return [ROOT / "seatrial/command_line.py", *parts]


@cache
def nodes() -> list[tuple[Path, ast.expr]]:
    """Return the calls and the texts in the code, with their files."""
    kinds = (ast.Call, ast.Constant, ast.JoinedStr, ast.BinOp)
    trees = ((path, ast.parse(path.read_text(encoding="utf-8"))) for path in sources())
    return [(path, node) for path, tree in trees for node in ast.walk(tree) if isinstance(node, kinds)]


@cache
def texts_in_code() -> str:
    """Return all texts in the code, separated by END. One search in it is much faster than one search in each text."""
    texts = {text for _, node in nodes() if not isinstance(node, ast.Call) for text in templates(node)}
    return END.join(sorted(texts))


@cache
def raised() -> tuple[tuple[str, str], ...]:
    """Return (where, template) of each error raised for the user that has a text of its own."""
    found = []
    for path, node in nodes():
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args):
            continue
        if node.func.id in ("SeatrialError", "SafetyStop"):
            where = f"{path.relative_to(ROOT)}:{node.lineno}"
            found += [(where, text) for text in templates(node.args[0]) if re.search(r"[a-z]{2,}", text)]
    return tuple(found)


def pattern(quoted: str) -> re.Pattern[str]:
    """Return a pattern for templates that matches a quoted line. … matches any text, up to the end of the template."""
    pieces = [re.escape(piece) for piece in quoted.strip(GAP + " ").split(GAP)]
    return re.compile(f"[^{END}]*".join(pieces))


def quoted() -> list[str]:
    """Return the first cells of the page's tables that contain a quoted line."""
    rows = re.findall(r"^\| `([^`]+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [row.replace("\\|", "|") for row in rows]


def test_the_page_quotes_messages() -> None:
    lines = quoted()
    assert len(lines) > 150
    assert not {line for line in lines if lines.count(line) > 1}


def test_each_quoted_line_is_in_the_code() -> None:
    stale = []
    for line in quoted():
        assert re.search(r"\w{2}", line.replace(GAP, "")), f"a line of dots says nothing: {line}"
        if not pattern(line).search(texts_in_code()):
            stale.append(line)
    assert not stale, "docs/troubleshooting.md quotes what no text in the code reads"


def test_nearly_every_error_is_on_the_page() -> None:
    patterns = [pattern(line) for line in quoted()]
    untold = [f"{where}: {text}" for where, text in raised() if not any(p.search(text) for p in patterns)]
    share = 1.0 - len(untold) / len(raised())
    assert share >= LEAST_TOLD, f"docs/troubleshooting.md tells {share:.0%}; not:\n" + "\n".join(untold)

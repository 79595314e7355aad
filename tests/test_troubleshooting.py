"""docs/troubleshooting.md against the code: each line it quotes is one that the code says; hardly one is missing.

A message is compared as a template: what the code fills in stands as … there and here.
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
# Another engineer's new error may be there before its line in the page is; a tenth is not.
LEAST_TOLD = 0.9


def templates(node: ast.expr) -> Iterator[str]:
    """The texts that an expression can be, with … where something is filled in."""
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
def said() -> tuple[str, ...]:
    """Every text in the code."""
    texts = {
        text
        for path in sources()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, (ast.Constant, ast.JoinedStr, ast.BinOp))
        for text in templates(node)
    }
    return tuple(sorted(texts))


@cache
def raised() -> tuple[tuple[str, str], ...]:
    """(where, template) of what is raised as a user's error and says something of its own."""
    found = []
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args):
                continue
            if node.func.id in ("SeatrialError", "SafetyStop"):
                where = f"{path.relative_to(ROOT)}:{node.lineno}"
                found += [(where, text) for text in templates(node.args[0]) if re.search(r"[a-z]{2,}", text)]
    return tuple(found)


def pattern(quoted: str) -> re.Pattern[str]:
    """A quoted line as a pattern for templates: … stands for anything."""
    pieces = [re.escape(piece) for piece in quoted.strip(GAP + " ").split(GAP)]
    return re.compile(".*".join(pieces), re.DOTALL)


def quoted() -> list[str]:
    """The first cells of the page's tables that are a quoted line."""
    rows = re.findall(r"^\| `([^`]+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return [row.replace("\\|", "|") for row in rows]


def test_the_page_has_lines_to_look_up() -> None:
    lines = quoted()
    assert len(lines) > 150
    assert not {line for line in lines if lines.count(line) > 1}


def test_each_line_is_one_that_the_code_says() -> None:
    stale = []
    for line in quoted():
        assert re.search(r"\w{2}", line.replace(GAP, "")), f"a line of dots says nothing: {line}"
        found = pattern(line)
        if not any(found.search(text) for text in said()):
            stale.append(line)
    assert not stale, "docs/troubleshooting.md quotes what no text in the code reads"


def test_hardly_an_error_is_missing() -> None:
    patterns = [pattern(line) for line in quoted()]
    untold = [f"{where}: {text}" for where, text in raised() if not any(p.search(text) for p in patterns)]
    share = 1.0 - len(untold) / len(raised())
    assert share >= LEAST_TOLD, f"docs/troubleshooting.md tells {share:.0%}; not:\n" + "\n".join(untold)

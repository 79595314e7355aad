"""The house: files of about 300 lines, functions of about 40, nothing left behind."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CODE = ("seatrial.py", "daq", "bench", "ident", "mocks", "benchmarks", "docs", "tests")
# "About" is this much: a ceiling for each, and a share of all that may be above the aim. No file is excepted.
FILE_LINES, FILE_CEILING = 300, 400
FUNCTION_LINES, FUNCTION_CEILING = 40, 60
SHARE = 0.03


def files() -> list[Path]:
    """Every Python file of the project."""
    found = [ROOT / name for name in CODE]
    return sorted(path for top in found for path in ([top] if top.suffix else top.rglob("*.py")))


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """(name, lines) of every function in a file, methods and inner ones too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            assert node.end_lineno is not None
            yield node.name, node.end_lineno - node.lineno + 1


def check(sizes: dict[str, int], aim: int, ceiling: int) -> None:
    """Nothing above the ceiling, and no more than a few above the aim."""
    above = {name: size for name, size in sizes.items() if size > aim}
    assert not {name: size for name, size in above.items() if size > ceiling}, f"more than {ceiling} lines"
    assert len(above) <= SHARE * len(sizes), f"{len(above)} of {len(sizes)} have more than {aim} lines: {above}"


def test_files_are_short() -> None:
    check(
        {str(p.relative_to(ROOT)): len(p.read_text(encoding="utf-8").splitlines()) for p in files()},
        FILE_LINES,
        FILE_CEILING,
    )


def test_functions_are_short() -> None:
    check(
        {f"{p.relative_to(ROOT)}:{name}": lines for p in files() for name, lines in functions(p)},
        FUNCTION_LINES,
        FUNCTION_CEILING,
    )


def test_the_check_sees_what_is_long() -> None:
    check({"a": 41} | {f"b{k}": 5 for k in range(99)}, 40, 60)
    with pytest.raises(AssertionError, match="more than 60"):
        check({"a": 61} | {f"b{k}": 5 for k in range(99)}, 40, 60)
    with pytest.raises(AssertionError, match="4 of 100"):
        check({f"a{k}": 41 for k in range(4)} | {f"b{k}": 5 for k in range(96)}, 40, 60)


def mentioned(tree: ast.AST) -> Iterator[str]:
    """Modules that a file imports, or names in a text as "module" or "module:attribute"."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value.partition(":")[0]


def test_every_module_is_used_by_another() -> None:
    """A module that only its own tests know is dead."""
    own = [path for path in files() if path.relative_to(ROOT).parts[0] in ("daq", "bench", "ident", "mocks")]
    used = {path: set(mentioned(ast.parse(path.read_text(encoding="utf-8")))) for path in files()}
    dead = []
    for path in own:
        parts = path.relative_to(ROOT).with_suffix("").parts
        catalogue = parts[:2] == ("ident", "effects")  # all of the folder is loaded
        if catalogue or parts[-1] in ("__init__", "__main__"):
            continue
        module, own_test = ".".join(parts), f"test_{parts[-1]}"
        if not any(module in names for user, names in used.items() if user.stem != own_test):
            dead.append(module)
    assert not dead

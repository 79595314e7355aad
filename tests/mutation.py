"""Mutation test of the safety code: change one thing at a time, and count how many changes the tests notice.

    python -m tests.mutation --jobs 2
    python -m tests.mutation --only watchdog --sample 60 --seed 1

Each mutant is a copy of the tree with one change: a comparison or condition is negated, `and` and `or` or two operators
are swapped, a number is doubled, or a statement is left out. A mutant that the tests of its file let pass survives; it
is printed with its line. Exit status 1 if less than 95 % are noticed.
"""

from __future__ import annotations

import argparse
import ast
import concurrent.futures
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("bench", "daq", "mocks", "ident", "tests", "seatrial.py", "pyproject.toml")
WANTED = 0.95
PATIENCE_S = 180.0
NEGATED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
SWAPPED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip


Change = Callable[[Any], bool]  # of a node, in place


class Target(NamedTuple):
    """A file under test, and the tests that have to notice its mutants, quick ones first."""

    path: str
    tests: tuple[str, ...]


TARGETS = (
    Target(
        "bench/execution/safety_guard.py",
        tuple(f"tests/bench/execution/test_{name}.py" for name in ("safety_guard", "autopilots", "guard_machine")),
    ),
    Target(
        "daq/acquisition/watchdog.py",
        ("tests/daq/acquisition/test_watchdog_parts.py", "tests/bench/execution/test_watchdog.py"),
    ),
)


class Mutant(NamedTuple):
    """One change of one file."""

    target: Target
    line: int
    what: str
    source: str


def mutants(target: Target) -> Iterator[Mutant]:
    """Yield every mutant of a file."""
    tree = ast.parse((ROOT / target.path).read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    for index, node in enumerate(nodes):
        for what, change in _changes(node):
            changed = copy.deepcopy(tree)
            twin = list(ast.walk(changed))[index]
            if change(twin):
                source = ast.unparse(ast.fix_missing_locations(changed))
                yield Mutant(target, getattr(node, "lineno", 0), what, source)


def _changes(node: ast.AST) -> Iterator[tuple[str, Change]]:
    """Yield the names and functions of the changes that a node allows; a function changes the node in place."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in NEGATED:
        yield "comparison negated", _negate
    elif isinstance(node, ast.BoolOp):
        yield "and/or swapped", _swap_bool
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPPED and not _is_text(node):
        yield "operator swapped", _swap
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield "number doubled", _double
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield "truth negated", _flip
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "not left out", _affirm
    elif isinstance(node, (ast.FunctionDef, ast.If, ast.For, ast.While, ast.With, ast.Try)):
        for k, statement in enumerate(node.body):
            docstring = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if isinstance(statement, (ast.Expr, ast.AugAssign, ast.Delete)) and not docstring:
                yield f"statement {k + 1} left out", _leaving_out(k)


def _is_text(node: ast.BinOp) -> bool:
    """Whether an operator joins texts."""
    texts = (side.value if isinstance(side, ast.Constant) else side for side in (node.left, node.right))
    return any(isinstance(side, (str, ast.JoinedStr)) for side in texts)


def _negate(node: ast.Compare) -> bool:
    node.ops[0] = NEGATED[type(node.ops[0])]()
    return True


def _swap_bool(node: ast.BoolOp) -> bool:
    node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
    return True


def _swap(node: ast.BinOp) -> bool:
    node.op = SWAPPED[type(node.op)]()
    return True


def _double(node: ast.Constant) -> bool:
    node.value = 2 * node.value if node.value else 1  # type: ignore[operator]
    return True


def _flip(node: ast.Constant) -> bool:
    node.value = not node.value
    return True


def _affirm(node: ast.UnaryOp) -> bool:
    node.op = ast.UAdd()
    inner = node.operand
    node.operand = ast.Call(ast.Name("bool", ast.Load()), [inner], [])
    return True


def _leaving_out(k: int) -> Change:
    def change(node: ast.FunctionDef) -> bool:
        node.body[k] = ast.Pass()
        return True

    return change


def survives(mutant: Mutant) -> bool:
    """Whether the tests let a mutant pass."""
    with tempfile.TemporaryDirectory(prefix="seatrial-mutant-") as name:
        tree = Path(name)
        for part in COPIED:
            source = ROOT / part
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__", "*.jsonl")
                shutil.copytree(source, tree / part, ignore=ignored, copy_function=os.link)
            else:
                shutil.copy(source, tree / part)
        changed = tree / mutant.target.path
        changed.unlink()  # it is a link to the original
        changed.write_text(mutant.source, encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *mutant.target.tests]
        environment = {**os.environ, "PYTHONPATH": name, "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            done = subprocess.run(
                command, cwd=tree, env=environment, capture_output=True, timeout=PATIENCE_S, check=False
            )
        except subprocess.TimeoutExpired:
            return False
        return done.returncode == 0


def main() -> int:
    """Run the mutants of the command line; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="part of the path of a file")
    parser.add_argument("--sample", type=int, help="so many mutants of each file, drawn [default: all]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    status = 0
    for target in TARGETS:
        if options.only not in target.path:
            continue
        found = list(mutants(target))
        if options.sample is not None and options.sample < len(found):
            found = random.Random(options.seed).sample(found, options.sample)
        alive = 0
        with concurrent.futures.ThreadPoolExecutor(options.jobs) as pool:
            for k, (mutant, lives) in enumerate(zip(found, pool.map(survives, found), strict=True), start=1):
                alive += lives
                if lives:
                    print(f"{mutant.target.path}:{mutant.line}: survives: {mutant.what}", flush=True)
                if k % 25 == 0:
                    print(f"{k} of {len(found)}, {k - alive} noticed", file=sys.stderr, flush=True)
        share = 1.0 - alive / max(len(found), 1)
        print(f"{target.path}: {len(found) - alive} of {len(found)} mutants noticed, {100 * share:.1f} %", flush=True)
        status |= share < WANTED
    return status


if __name__ == "__main__":
    sys.exit(main())

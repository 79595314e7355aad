"""Mutation test of the safety code: make one change at a time, and count the changes that the tests detect.

    python -m tests.mutation --jobs 2
    python -m tests.mutation --only watchdog --sample 60 --seed 1

Each mutant is a copy of the tree with one change: a comparison or condition is negated, `and` and `or` or two operators
are swapped, a number is doubled, or a statement is left out. A mutant survives if the tests of its file pass. The
program prints each survivor with its line. The exit status is 1 if less than 95 % are detected.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import itertools
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
import threading
import time
import types
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("bench", "daq", "mocks", "ident", "seatrial", "tests", "pyproject.toml")
WANTED = 0.95
ANYWHERE = 0  # stands for a function's line in the case of module-level code
PATIENCE_S = 60.0  # time limit of one test
LIMIT_S = 240.0  # time limit of all tests of a file with one mutant
NEGATED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
SWAPPED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip


WORDS = (
    "-x", "-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning",
    f"--timeout={PATIENCE_S:g}",
)  # fmt: skip

Change = Callable[[Any], None]  # changes a node in place


class Target(NamedTuple):
    """File under test, and the tests that have to detect its mutants."""

    path: str
    tests: tuple[str, ...]
    imported: tuple[str, ...]  # modules that do not import the file; they are imported once, before the mutants
    # whether a mutant only runs the tests that call the changed function; not possible if tests start processes
    selects: bool


LIBRARIES = ("numpy", "scipy.optimize", "hypothesis", "pymavlink.mavutil", "mcap.reader", "click", "serial", "can")
TARGETS = (
    Target(
        "bench/execution/safety_guard.py",
        tuple(f"tests/bench/execution/test_{name}.py" for name in ("safety_guard", "autopilots", "guard_machine")),
        (*LIBRARIES, *(f"seatrial.daq.{m}" for m in ("acquisition.session", "config", "drivers", "log.reader"))),
        selects=True,
    ),
    Target(
        "daq/acquisition/watchdog.py",
        ("tests/daq/acquisition/test_watchdog_parts.py", "tests/bench/execution/test_watchdog.py"),
        LIBRARIES,
        selects=False,
    ),
)


class Mutant(NamedTuple):
    """Change of one file."""

    target: Target
    node: int  # in the order of ast.walk
    change: int  # index among the changes that the node allows
    line: int
    what: str
    tests: tuple[str, ...]

    def source(self) -> str:
        """Return the text of the changed file."""
        tree = ast.parse((ROOT / self.target.path).read_text(encoding="utf-8"))
        node = next(itertools.islice(ast.walk(tree), self.node, None))
        _, change = next(itertools.islice(_changes(node), self.change, None))
        change(node)
        return ast.unparse(ast.fix_missing_locations(tree))


def mutants(target: Target, calls: Mapping[int, Sequence[str]]) -> Iterator[Mutant]:
    """Yield every mutant of a file with its tests: those that call its function, or all tests for module-level code."""
    tree = ast.parse((ROOT / target.path).read_text(encoding="utf-8"))
    owners: dict[ast.AST, int] = {}  # first line of the innermost function around a node
    options: set[ast.AST] = set()  # arguments of decorators, such as `frozen=True`, are not behaviour
    for function in ast.walk(tree):
        if isinstance(function, (ast.FunctionDef, ast.ClassDef)):
            options.update(node for decorator in function.decorator_list for node in ast.walk(decorator))
        if isinstance(function, (ast.FunctionDef, ast.Lambda)):
            decorators = function.decorator_list if isinstance(function, ast.FunctionDef) else []
            first = min([function.lineno, *(decorator.lineno for decorator in decorators)])
            body = function.body if isinstance(function.body, list) else [function.body]
            owners.update((node, first) for statement in body for node in ast.walk(statement))
            owners[function] = first
    for index, node in enumerate(ast.walk(tree)):
        if node in options:
            continue
        tests = tuple(calls.get(owners.get(node, ANYWHERE), ())) if target.selects else target.tests
        for k, (what, _) in enumerate(_changes(node)):
            yield Mutant(target, index, k, getattr(node, "lineno", 0), what, tests)


class CallRecorder:
    """Pytest plugin that records which tests call which functions of a file, and how long each test takes."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._callers: dict[int, set[str]] = {}  # by first line of the function
        self._duration: dict[str, float] = {}
        self._test = ""

    def _profile(self, frame: types.FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.endswith(self._path):
            self._callers.setdefault(frame.f_code.co_firstlineno, set()).add(self._test)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Record the calls of a test and of its fixtures."""
        self._test, begin = item.nodeid, time.perf_counter()
        sys.setprofile(self._profile)
        threading.setprofile(self._profile)
        try:
            return (yield)
        finally:
            sys.setprofile(None)
            self._duration[item.nodeid] = time.perf_counter() - begin

    def calls(self) -> dict[int, list[str]]:
        """Return the tests that call each function, the fastest first, and all tests at `ANYWHERE`."""
        callers = {**self._callers, ANYWHERE: set(self._duration)}
        return {line: sorted(tests, key=self._duration.__getitem__) for line, tests in callers.items()}


def record_calls(target: Target) -> dict[int, list[str]]:
    """Run the tests of a file once. Return which of them call which function, identified by its first line."""
    recorder = CallRecorder(target.path)
    status = pytest.main([*WORDS, *target.tests], plugins=[recorder])
    if status != pytest.ExitCode.OK:
        raise SystemExit(f"the tests of {target.path} fail without any change: mend them first")
    return recorder.calls()


def _changes(node: ast.AST) -> Iterator[tuple[str, Change]]:
    """Yield the names and functions of the changes that a node allows; a function changes the node in place."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in NEGATED:
        yield "comparison negated", _negate
    elif isinstance(node, ast.BoolOp):
        yield "and/or swapped", _swap_bool
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPPED and not _is_text(node) and not _is_by_one(node):
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
    """Return whether an operator joins texts."""
    texts = (side.value if isinstance(side, ast.Constant) else side for side in (node.left, node.right))
    return any(isinstance(side, (str, ast.JoinedStr)) for side in texts)


def _is_by_one(node: ast.BinOp) -> bool:
    """Return whether the right side is a constant equal to 1: multiplying and dividing by 1 are the same."""
    return isinstance(node.right, ast.Name) and node.right.id in ("STALE_WALL_S", "STALE_S")


def _negate(node: ast.Compare) -> None:
    node.ops[0] = NEGATED[type(node.ops[0])]()


def _swap_bool(node: ast.BoolOp) -> None:
    node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()


def _swap(node: ast.BinOp) -> None:
    node.op = SWAPPED[type(node.op)]()


def _double(node: ast.Constant) -> None:
    node.value = 2 * node.value if node.value else 1  # type: ignore[operator]


def _flip(node: ast.Constant) -> None:
    node.value = not node.value


def _affirm(node: ast.UnaryOp) -> None:
    node.op = ast.UAdd()
    inner = node.operand
    node.operand = ast.Call(ast.Name("bool", ast.Load()), [inner], [])


def _leaving_out(k: int) -> Change:
    def change(node: ast.FunctionDef) -> None:
        node.body[k] = ast.Pass()

    return change


def survives(mutant: Mutant) -> bool:
    """Return whether the tests pass with a mutant.

    The function runs in a process that has already imported the libraries.
    """
    with tempfile.TemporaryDirectory(prefix="seatrial-mutant-") as name:
        tree = Path(name)
        for part in COPIED:
            source = ROOT / part
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__", "*.jsonl")
                shutil.copytree(source, tree / part, ignore=ignored, copy_function=os.link, symlinks=True)
            else:
                shutil.copy(source, tree / part)
        changed = tree / mutant.target.path
        changed.unlink()  # a link to the original tree
        changed.write_text(mutant.source(), encoding="utf-8")
        os.chdir(tree)
        # The tests start processes of their own, which have to import the mutant too.
        os.environ |= {"PYTHONPATH": name, "PYTHONDONTWRITEBYTECODE": "1"}
        # a package with the modules of the original; other packages are imported from the copy
        if "seatrial" in sys.modules:
            sys.modules["seatrial"].__path__ = [str(tree / "seatrial")]
        sys.path[:] = [name, *(entry for entry in sys.path if entry not in ("", str(ROOT)))]
        sys.dont_write_bytecode = True
        with open(os.devnull, "w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        try:
            return not mutant.tests or pytest.main([*WORDS, *mutant.tests]) == pytest.ExitCode.OK
        except pytest.PytestUnhandledThreadExceptionWarning:
            return False  # a thread of a test raised after its test had ended, which fails an ordinary run too


def survives_in_process(mutant: Mutant) -> bool:
    """Return whether the tests pass with a mutant, in a process of its own.

    Tests that have not ended after ``LIMIT_S`` are counted as failed: a mutant can stop a thread from ever ending.
    """
    process = multiprocessing.get_context("fork").Process(target=lambda: sys.exit(0 if survives(mutant) else 1))
    process.start()
    process.join(LIMIT_S)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode == 0


def main() -> int:
    """Run the mutants of the command line and return the exit status."""
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
        for module in target.imported:
            importlib.import_module(module)
        fork = multiprocessing.get_context("fork")
        with fork.Pool(1) as pool:
            calls = pool.apply(record_calls, (target,)) if target.selects else {}
        found = list(mutants(target, calls))
        if options.sample is not None and options.sample < len(found):
            found = random.Random(options.seed).sample(found, options.sample)
        alive = 0
        with ThreadPoolExecutor(options.jobs) as jobs:
            lives_of = jobs.map(survives_in_process, found)
            for k, (mutant, lives) in enumerate(zip(found, lives_of, strict=True), start=1):
                alive += lives
                if lives:
                    print(f"{mutant.target.path}:{mutant.line}: survives: {mutant.what}", flush=True)
                if k % 10 == 0:
                    print(f"{k} of {len(found)}, {k - alive} noticed", file=sys.stderr, flush=True)
        share = 1.0 - alive / max(len(found), 1)
        print(f"{target.path}: {len(found) - alive} of {len(found)} mutants noticed, {100 * share:.1f} %", flush=True)
        status |= share < WANTED
    return status


if __name__ == "__main__":
    sys.exit(main())

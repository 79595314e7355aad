"""The words of the glossary: those that it retired do not come back in pages, docstrings and help texts."""

from __future__ import annotations

import ast
import gc
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from seatrial import command_line

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("daq", "bench", "ident", "mocks")
# The glossary's own table of retired words, and what tells of the past.
OUTSIDE = {"docs/glossary.md", "docs/decisions/0024-subpackages-and-standard-names.md", "CHANGELOG.md"}
PAGES = sorted(
    path for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")] if str(path.relative_to(ROOT)) not in OUTSIDE
)
MODULES = sorted(path for part in PARTS for path in (ROOT / part).rglob("*.py"))

# Only words that mean nothing else: `sure`, `take` or `told` would find too much that is right.
RETIRED = {
    r"free[- ]run(s|ning)?": "simulation",
    r"\bten_seconds\b": "horizon",
    r"\bnoughts?\b": "zero",
    r"\bwild\b": "outlier",
    r"\bnews\b": "innovation, sample",
    r"\bbegun\b": "initialised, started",
    r"\bfelt\b": "sensitive, measured",
    r"\btoo sure\b": "overconfident",
    r"\btoo cautious\b": "underconfident",
    r"\bcautions\b": "warnings",
    r"\bdoubts?\b": "caveat, parameter uncertainty",
    r"\bstretch(es)?\b": "segment",
    r"\brivals?\b": "competing model, alternative, baseline",
    r"\bunexplained forces?\b": "disturbance force",
    r"\bunknown effects?\b": "nonparametric effect",
    r"\bsealed\b": "ground truth",
    r"\bundeclared\b": "hidden",
    r"\bsalvag(e|es|ed|ing)\b": "recover",
    r"\blateness\b": "delay",
    r"\brooms\b": "wings",
    r"\bwander(s|ing)?\b": "random walk",
    r"--(ahead|agree|as-is|restricted|with-nuisance|without-gnss|between|spread|sealed)\b": "see the table",
}
# A word that is right in one place: (path, words around it).
ALLOWED = {
    ("docs/how-to/devices.md", "GPS weeks have begun again"),
    ("bench/execution/safety_guard.py", "RIVAL"),  # a stop code in logs
}


def prose(page: Path) -> str:
    """Return a page without code and output of the program, which other tests compare with their source."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`]*`|\]\([^)]*\)|^>.*$", "", text, flags=re.MULTILINE)


def found(path: str, text: str) -> list[str]:
    """Return each retired word of a text, with its surroundings and the term that replaces it."""
    lines = []
    for pattern, term in RETIRED.items():
        for match in re.finditer(pattern, text, re.IGNORECASE):
            around = text[max(match.start() - 30, 0) : match.end() + 30].replace("\n", " ")
            if not any(path == where and words in around for where, words in ALLOWED):
                lines.append(f"...{around}... -> {term}")
    return lines


def docstrings(path: Path) -> Iterator[str]:
    """Return the docstrings of a module, of its classes and of its functions."""
    gc.disable()  # to look for garbage among the nodes takes longer than to parse
    try:
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    finally:
        gc.enable()
    for node in nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""


def helps(command: click.Command, words: str) -> Iterator[tuple[str, str]]:
    """Yield (command, text) of a command and of all its subcommands."""
    options = [o.help or "" for o in command.params if isinstance(o, click.Option)]
    yield words, "\n".join([command.help or "", command.short_help or "", command.epilog or "", *options])
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from helps(below, f"{words} {name}")


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_pages_use_the_words_of_the_glossary(page: Path) -> None:
    assert not found(named(page), prose(page))


@pytest.mark.parametrize("module", MODULES, ids=named)
def test_docstrings_use_the_words_of_the_glossary(module: Path) -> None:
    assert not [line for text in docstrings(module) for line in found(named(module), text)]


def test_helps_use_the_words_of_the_glossary() -> None:
    assert not [line for words, text in helps(command_line.cli, "seatrial") for line in found(words, text)]

"""What a page is made of: sections of a few kinds of block, and the figures they point at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.ident.report.drawing import Budget, Figure


@dataclass(frozen=True)
class Prose:
    """A paragraph."""

    words: str
    style: str = ""
    kind: str = "prose"


@dataclass(frozen=True)
class Heading:
    """A small heading inside a section."""

    words: str
    note: str = ""
    kind: str = "heading"


@dataclass(frozen=True)
class Cell:
    """A table's cell; ``bar`` (-1..1) draws a small diverging bar beside the text."""

    words: str
    style: str = ""
    bar: float | None = None


@dataclass(frozen=True)
class Table:
    """``columns``: title and style (``num`` for numbers); a row of one cell is a group's heading."""

    columns: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[Cell | str]]
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True)
class Plot:
    """A place for a figure of the page."""

    id: str
    height: int
    label: str
    title: str = ""
    kind: str = "plot"


@dataclass(frozen=True)
class Grid:
    """Plots side by side as far as the width allows; ``least`` is a plot's least width [px]."""

    plots: Sequence[Plot]
    least: int = 260
    style: str = ""
    kind: str = "grid"


@dataclass(frozen=True)
class Key:
    """What the lines mean: pairs of style and words."""

    items: Sequence[tuple[str, str]]
    kind: str = "key"


@dataclass(frozen=True)
class Tabs:
    """Alternatives of which one is seen at a time; all of them in print."""

    tabs: Sequence[tuple[str, Sequence[Any]]]
    kind: str = "tabs"


@dataclass(frozen=True)
class Facts:
    """Pairs of a label and a value."""

    items: Sequence[tuple[str, str]]
    style: str = ""
    kind: str = "facts"


@dataclass(frozen=True)
class Lines:
    """A list of lines."""

    items: Sequence[str]
    style: str = ""
    kind: str = "lines"


@dataclass(frozen=True)
class Dumbbell:
    """One channel's error before and after: positions in percent of the track's width."""

    label: str
    before: str
    after: str
    change: str
    at_before: float
    at_after: float
    low: float | None
    high: float | None
    verdict: str  # better, worse, same


@dataclass(frozen=True)
class Dumbbells:
    """Errors before and after on one relative scale."""

    items: Sequence[Dumbbell]
    caption: str
    kind: str = "dumbbells"


@dataclass(frozen=True)
class EffectCard:
    """An effect that was added to the model."""

    title: str
    name: str
    formula: str
    parameters: Sequence[tuple[str, str, str]]
    facts: Sequence[tuple[str, str]]
    weight: str
    weight_says: str
    kind: str = "effect"


@dataclass(frozen=True)
class Bar:
    """One candidate: bar and threshold in percent of the track's width."""

    label: str
    name: str
    numbers: str
    width: float
    threshold: float
    generic: bool
    passed: bool
    chosen: bool


@dataclass(frozen=True)
class Ranking:
    """Candidates on a logarithmic axis; ``ticks`` are positions [%] and words."""

    bars: Sequence[Bar]
    ticks: Sequence[tuple[float, str]]
    caption: str
    kind: str = "ranking"


@dataclass(frozen=True)
class Verdict:
    """One finding of a check: ``level`` is fault, warning or ok; what was found where, and what to do about it."""

    level: str
    where: str
    check: str
    words: str
    advice: str


@dataclass(frozen=True)
class Verdicts:
    """Findings below each other."""

    items: Sequence[Verdict]
    kind: str = "verdicts"


@dataclass(frozen=True)
class Section:
    """One heading of the page; a section without blocks is not shown."""

    id: str
    title: str
    blocks: Sequence[Any]
    lead: str = ""


@dataclass
class Canvas:
    """Collects the page's figures while the sections are built."""

    budget: Budget
    figures: dict[str, Figure] = field(default_factory=dict)

    def plot(self, figure: Figure, height: int, label: str, title: str = "") -> Plot:
        """Keep a figure and return its place; ``label`` says what it shows to who cannot see it."""
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = figure
        return Plot(name, height, label, title)


def tabbed(tabs: Sequence[tuple[str, Sequence[Any]]]) -> list[Any]:
    """Tabs; a lone one is shown without, under its title; empty ones are left out."""
    full = [(title, list(blocks)) for title, blocks in tabs if blocks]
    if len(full) == 1:
        return [Heading(full[0][0]), *full[0][1]]
    return [Tabs(full)] if full else []

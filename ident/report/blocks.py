"""Parts of a page: sections, their blocks (text, tables, plots, tabs), and the collector of figures.

Blocks contain texts and numbers that are ready to show. ``templates/blocks.html.j2`` renders each by its ``kind``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.ident.report.drawing import Budget, Figure


@dataclass(frozen=True)
class Prose:
    """A paragraph."""

    words: str
    style: str = ""  # CSS class
    kind: str = "prose"


@dataclass(frozen=True)
class Heading:
    """A small heading inside a section, with a note in smaller type."""

    words: str
    note: str = ""
    kind: str = "heading"


@dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    words: str
    style: str = ""  # CSS class
    bar: float | None = None  # -1..1: length of a small bar beside the text, to the left if negative


@dataclass(frozen=True)
class Table:
    """A table with a header row."""

    columns: Sequence[tuple[str, str]]  # title and CSS class (``num`` for numbers)
    rows: Sequence[Sequence[Cell | str]]  # a row of one cell is the heading of a group
    caption: str = ""
    kind: str = "table"


@dataclass(frozen=True)
class Plot:
    """The place of a figure on the page."""

    id: str  # key in ``Canvas.figures``
    height: int  # px
    label: str  # description for screen readers
    title: str = ""  # heading above the figure
    kind: str = "plot"


@dataclass(frozen=True)
class Grid:
    """Plots side by side, as many in a row as fit the page."""

    plots: Sequence[Plot]
    least: int = 260  # smallest width of a plot [px]
    style: str = ""
    kind: str = "grid"


@dataclass(frozen=True)
class Key:
    """Legend of the lines and symbols in the figures below."""

    items: Sequence[tuple[str, str]]  # CSS class of the symbol, meaning
    kind: str = "key"


@dataclass(frozen=True)
class Tabs:
    """Tabs: one is visible at a time; a printed page contains all."""

    tabs: Sequence[tuple[str, Sequence[Any]]]  # title, blocks
    kind: str = "tabs"


@dataclass(frozen=True)
class Facts:
    """List of labelled values."""

    items: Sequence[tuple[str, str]]  # label, value
    style: str = ""
    kind: str = "facts"


@dataclass(frozen=True)
class Lines:
    """List of sentences."""

    items: Sequence[str]
    style: str = ""
    kind: str = "lines"


@dataclass(frozen=True)
class Dumbbell:
    """Prediction error of one channel before and after an effect was added, drawn as two dots on a track.

    The positions are in per cent of the track's width.
    """

    label: str
    before: str
    after: str
    change: str
    at_before: float
    at_after: float
    low: float | None  # ends of the 95 % interval
    high: float | None
    verdict: str  # better, worse, same


@dataclass(frozen=True)
class Dumbbells:
    """Prediction errors before and after, of several channels on one relative scale."""

    items: Sequence[Dumbbell]
    caption: str
    kind: str = "dumbbells"


@dataclass(frozen=True)
class EffectCard:
    """Card of an effect that was added to the model."""

    title: str
    name: str
    formula: str
    parameters: Sequence[tuple[str, str, str]]  # name, value with standard error, meaning
    facts: Sequence[tuple[str, str]]  # label, value
    importance: str  # how much larger the prediction error is without the effect: the number
    importance_words: str  # the words after the number
    kind: str = "effect"


@dataclass(frozen=True)
class Bar:
    """Bar of one candidate's score test; lengths in per cent of the track's width."""

    label: str
    name: str
    numbers: str
    width: float
    threshold: float
    generic: bool  # a nonparametric curve, not an effect of the catalogue
    passed: bool
    chosen: bool


@dataclass(frozen=True)
class Ranking:
    """Bar chart of the candidates' score tests on a logarithmic axis."""

    bars: Sequence[Bar]
    ticks: Sequence[tuple[float, str]]  # position [%], label
    caption: str
    kind: str = "ranking"


@dataclass(frozen=True)
class Verdict:
    """One finding of a data check."""

    level: str  # fault, warning, ok
    where: str  # log or signal
    check: str  # name of the check
    words: str  # what was found
    advice: str  # what to do


@dataclass(frozen=True)
class Verdicts:
    """List of findings."""

    items: Sequence[Verdict]
    kind: str = "verdicts"


@dataclass(frozen=True)
class Section:
    """A section of the page; pages leave out a section without blocks."""

    id: str  # anchor
    title: str
    blocks: Sequence[Any]
    lead: str = ""  # introductory paragraph


@dataclass
class Canvas:
    """Collector of a page's figures while its sections are built."""

    budget: Budget
    figures: dict[str, Figure] = field(default_factory=dict)

    def plot(self, figure: Figure, height: int, label: str, title: str = "") -> Plot:
        """Store a figure and return its place on the page.

        Parameters
        ----------
        figure : Figure
            Plotly figure.
        height : int
            Height [px].
        label : str
            Description of the figure for screen readers.
        title : str
            Heading above the figure.
        """
        name = f"figure-{len(self.figures) + 1}"
        self.figures[name] = figure
        return Plot(name, height, label, title)


def tabbed(tabs: Sequence[tuple[str, Sequence[Any]]]) -> list[Any]:
    """Return a ``Tabs`` block of the tabs that have blocks.

    If only one tab has blocks, return its title as a heading followed by its blocks.
    """
    full = [(title, list(blocks)) for title, blocks in tabs if blocks]
    if len(full) == 1:
        return [Heading(full[0][0]), *full[0][1]]
    return [Tabs(full)] if full else []

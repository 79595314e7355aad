"""Figures of the Python interface: shown in notebooks, written as HTML pages, and converted to Plotly's objects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from seatrial.api.arguments import as_path
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output

PLOTLY_JSON = "application/vnd.plotly.v1+json"  # type of figures that notebooks draw


@dataclass(frozen=True, repr=False)
class Figure:
    """Interactive figure in the JSON of Plotly.

    A notebook draws the figure if it is the last value of a cell. The Python package plotly is needed only for
    `to_plotly` and `show`.

    Attributes
    ----------
    title : str
        Title of the figure.
    data : list of dict
        Plotly traces: curves, points and bands.
    layout : dict
        Plotly layout: axes and their titles.
    """

    title: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]

    def __repr__(self) -> str:
        """Return a short text for the interpreter: the title and the number of Plotly traces."""
        return f"<Figure {self.title!r}: {len(self.data)} traces>"

    def to_dict(self) -> dict[str, Any]:
        """Return the figure as a dictionary with ``data`` and ``layout``, whose values JSON can represent.

        The values are those of the figure and not copies. The `title` is not in the dictionary.
        """
        return {"data": self.data, "layout": self.layout}

    def _repr_mimebundle_(self, **_: Any) -> dict[str, Any]:
        """Return the figure by MIME type, as a notebook draws it, and a text with its title for other displays.

        The keyword arguments of the notebook are ignored.
        """
        return {PLOTLY_JSON: self.to_dict(), "text/plain": repr(self)}

    def to_plotly(self) -> Any:
        """Return the figure as ``plotly.graph_objects.Figure``.

        Raises
        ------
        SeatrialError
            If the Python package plotly is not installed.
        """
        try:
            from plotly import graph_objects
        except ModuleNotFoundError:
            raise SeatrialError(
                "the Python package plotly is not installed, and this conversion needs it: pip install plotly; "
                "notebooks draw the figure without it, and save(FILE.html) writes a page"
            ) from None
        return graph_objects.Figure(self.to_dict())

    def show(self) -> None:
        """Open the figure in the browser, by Plotly.

        Raises
        ------
        SeatrialError
            If the Python package plotly is not installed.
        """
        self.to_plotly().show()

    def save(self, path: Path | str) -> None:
        """Write the figure as an HTML page, which needs no network.

        Parameters
        ----------
        path : Path or str
            File, for example ``prediction.html``. An existing file is replaced. Its folder is created if it does not
            exist.
        """
        from seatrial.ident.report import figure_page

        write_output(as_path(path, "path"), figure_page(self.title, self.to_dict()).encode())

"""What `plot_...` gives back: the axes of a figure, which a notebook shows as the picture they make."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stickslip_fit.report.figures.drawing import Drawing


class Panels(np.ndarray):
    """The axes of one figure, row by row: numpy's array of them, shape (panels,).

    A figure is made without pyplot, so that nothing keeps it open. A cell that ends with its panels shows it
    once; a cell that changes them first shows it changed.

    Examples
    --------
    >>> figure = Drawing()
    >>> _ = figure.subplots(1, 2)
    >>> both = panels(figure)
    >>> both
    2 panels of a figure
    >>> both[0].set_title("left").get_text()
    'left'
    """

    @property
    def figure(self) -> Drawing:
        """The figure that they are of."""
        first: Any = self.flat[0]
        return first.get_figure(root=True)

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Write the figure to a file; see `matplotlib.figure.Figure.savefig`."""
        self.figure.savefig(*arguments, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        return self.figure._repr_png_()

    def __repr__(self) -> str:
        return f"{self.size} panel{'s' * (self.size > 1)} of a figure"

    __str__ = __repr__


def panels(figure: Figure) -> Panels:
    """The axes of a drawn figure that have something in them."""
    shown = [axes for axes in figure.axes if axes.axison and axes.get_visible()]
    found = np.empty(len(shown), dtype=object)
    found[:] = shown
    return found.view(Panels)

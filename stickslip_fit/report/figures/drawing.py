"""A figure that a notebook shows by itself, whatever the plotting backend."""

from __future__ import annotations

import io

from matplotlib.figure import Figure

DOTS = 200  # an inch; sharp on any screen, and shown at `SHOWN` an inch
SHOWN = 100


class Drawing(Figure):
    """A figure made without pyplot: nothing keeps it open, and a cell that ends with it shows it."""

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=DOTS)
        wide, tall = self.get_size_inches()
        return stream.getvalue(), {"width": round(SHOWN * wide), "height": round(SHOWN * tall)}


def on_white[Shown: Figure](figure: Shown) -> Shown:
    """The figure with a background of its own: ink on a dark notebook could not be read."""
    figure.set_facecolor("white")
    return figure

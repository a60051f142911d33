"""A figure of a report: drawn the same on a page of its own and on one of the PDF's."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure, FigureBase

from mrnav_server.study.style import COLUMN_IN, WIDTH_IN, watermark


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A figure.

    Attributes:
        name: Of its files.
        title: In a few words.
        caption: What is drawn, complete in itself.
        height_in: At the width of two columns.
        column_in: Its height at the width of one column.
        draw: Draws it; told whether it has one column alone.
        mark: Written across it; "" for nothing.
    """

    name: str
    title: str
    caption: str
    height_in: float
    column_in: float
    draw: Callable[[FigureBase, bool], None]
    mark: str

    def onto(self, figure: FigureBase, narrow: bool = False) -> None:
        """Draw it, with its watermark."""
        self.draw(figure, narrow)
        if self.mark:
            watermark(figure, self.mark)

    def alone(self, narrow: bool = False) -> Figure:
        """Return it on a page of its own, as wide as two columns or as one."""
        size_in = (COLUMN_IN, self.column_in) if narrow else (WIDTH_IN, self.height_in)
        figure = Figure(figsize=size_in, layout="constrained")
        self.onto(figure, narrow)
        return figure

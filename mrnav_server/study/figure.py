"""A figure of a report: drawn the same on a page of its own and on one of the PDF's."""

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.figure import Figure, FigureBase

from mrnav_server.study.style import WIDTH_IN, watermark


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A figure.

    Attributes:
        name: Of its files.
        title: In a few words.
        caption: What is drawn, complete in itself.
        height_in: At the width of two columns.
        draw: Draws it.
        mark: Written across it; "" for nothing.
    """

    name: str
    title: str
    caption: str
    height_in: float
    draw: Callable[[FigureBase], None]
    mark: str

    def onto(self, figure: FigureBase) -> None:
        """Draw it, with its watermark."""
        self.draw(figure)
        if self.mark:
            watermark(figure, self.mark)

    def alone(self) -> Figure:
        """Return it on a page of its own."""
        figure = Figure(figsize=(WIDTH_IN, self.height_in), layout="constrained")
        self.onto(figure)
        return figure

"""Draws the diagram of the modes in docs/safety.md anew: ``python docs/draw_modes.py``."""

from pathlib import Path

from mrnav_server.core.mode_diagram import PICTURE, page_with, svg, transitions

FOLDER = Path(__file__).resolve().parent

if __name__ == "__main__":
    edges, page = transitions(), FOLDER / "safety.md"
    (FOLDER / PICTURE).write_text(svg(edges), encoding="utf-8")
    page.write_text(page_with(page.read_text(encoding="utf-8"), edges), encoding="utf-8")

"""Writes the pages' types of the twin's messages anew: ``python docs/write_twin_types.py``."""

from pathlib import Path

from mrnav_server.app.twin_jsdoc import FILE, twin_types

if __name__ == "__main__":
    (Path(__file__).resolve().parents[1] / FILE).write_text(twin_types(), encoding="utf-8")

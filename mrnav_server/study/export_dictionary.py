"""What is written beside an export, for whoever opens it: README.md and columns.csv."""

import csv
from pathlib import Path

from mrnav_server.study.export_topics import tables

README_NAME = "README.md"
COLUMNS_NAME = "columns.csv"


def write_dictionary(folder: Path, origin: str, version: str) -> list[Path]:
    """Write what every table and column means; return the files.

    Args:
        folder: The export's folder.
        origin: Whose trials these are, in words.
        version: Of the software that exported them.
    """
    readme, columns = folder / README_NAME, folder / COLUMNS_NAME
    parts = [_HEAD.format(origin=origin, version=version)]
    with columns.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("table", "column", "kind", "unit", "meaning"))
        for name, meaning, found in tables():
            parts.append(
                f"\n## {name}\n\nA row: {meaning}.\n\n| column | kind | unit | meaning |\n|---|---|---|---|\n"
            )
            for each in found:
                writer.writerow((name, each.name, each.kind, each.unit, each.meaning))
                parts.append(f"| `{each.name}` | {each.kind} | {each.unit} | {each.meaning} |\n")
    readme.write_text("".join(parts), encoding="utf-8")
    return [readme, columns]


_HEAD = """# Exported trials

**{origin}.** Written by mrnav-server {version}. `columns.csv` holds the tables below for programs.

- `csv/` and `parquet/`: one table a topic of the log, the trials one after the other, and `trials`, one row a
  trial. In Parquet, unit and meaning are in each column's metadata, too.
- `mcap/`: one file a trial. The channels `/track`, `/hand`, ... hold the same columns as JSON, without those
  that say whose trial it is: these are in each channel's metadata. `/foxglove/...` is for looking at it.
- Units are suffixes of the columns. An empty cell says that there was nothing to say: no robot in the
  picture, for example. An empty text is a text: in CSV it is `""`.
- `t_s` is monotonic, begins with the trial, and tells when something happened: the middle of the exposure,
  the arrival of the hand's line, the sending of a command. `logged_...` tells when the line was written down.
- Frames: `x_um`, `y_um` and `vessel_..._px` in the vessel's grid, x to the right and y downwards;
  `image_..._px` in the camera's picture; `tip_`, `setpoint_`, `asked_` and `target_..._um` on the stage,
  z up; `hand_..._m` in the hand's own axes.
- All three formats give the logs back to the last byte: `mrnav study import`.
"""

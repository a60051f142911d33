"""`mrnav map show`: a vessel model in figures."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mrnav_server.training.map_report import MapReport

_SHOWN_PLACES = 8


def show(
    model: Annotated[str, typer.Argument(help="Vessel model: a name or a folder.")],
    preview: Annotated[Path | None, typer.Option(help="Draw the model into this PNG.")] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on the last line.")
    ] = False,
) -> None:
    """Tell what a vessel model is like, where it comes from, and whether it has a policy."""
    from mrnav_server.training.map_import import report_notes
    from mrnav_server.training.map_preview import save_preview
    from mrnav_server.training.map_report import map_report
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model, read_model_json

    folder = find_model(model)
    report = map_report(load_vessel_model(folder))
    if preview is not None:
        save_preview(preview, report)
    print_report(report, str(read_model_json(folder).get("source", "")), report_notes(report))
    trained = (folder / "policy.pt").is_file()
    typer.echo("it has a policy" if trained else f"it has no policy: mrnav train {model} makes one")
    if json_output:
        typer.echo(json.dumps(report.record()))


def print_report(report: "MapReport", source: str, notes: tuple[str, ...]) -> None:
    """Print a model's figures as a table, and what to look at below it."""
    from rich.console import Console
    from rich.table import Table

    vessel = report.vessel
    side_mm = vessel.size_px * vessel.um_per_px / 1000
    lumen = vessel.lumen.mean()
    least, median, most = (width / 1000 for width in report.widths_um)
    tight_mm = sum(place.length_um for place in report.tight) / 1000
    table = Table(title=f"{vessel.name}: {source}" if source else vessel.name, show_header=False)
    rows = (
        ("grid", f"{vessel.size_px} x {vessel.size_px} px of {vessel.um_per_px:g} µm: {side_mm:g} mm"),
        ("robot", f"{2 * vessel.robot_radius_px * vessel.um_per_px / 1000:g} mm wide"),
        ("lumen", f"{lumen:.1%} of the grid"),
        ("room for the robot's centre", f"{report.free_fraction:.1%} of the grid"),
        (
            "centre line",
            f"{report.length_um / 1000:.1f} mm, the robot reaches {report.reached_um / 1000:.1f}",
        ),
        ("branches, junctions, ends", f"{len(report.line.branches)}, {report.junctions}, {report.line.ends}"),
        ("width, least, median, most", f"{least:.2f}, {median:.2f}, {most:.2f} mm"),
        ("where the robot does not fit", f"{len(report.tight)} places, {tight_mm:.1f} mm"),
        (
            "suggested critical areas",
            ", ".join(f"({a.x_px:.0f}, {a.y_px:.0f})" for a in vessel.suggested_areas),
        ),
    )
    for name, value in rows:
        table.add_row(name, value or "none")
    console = Console(width=110, highlight=False)
    console.print(table)
    if report.tight:
        places = Table("at (px)", "narrowest (mm)", "length (mm)", title="Where the robot does not fit")
        for place in report.tight[:_SHOWN_PLACES]:
            at = f"({place.x_px}, {place.y_px})"
            places.add_row(at, f"{place.width_um / 1000:.2f}", f"{place.length_um / 1000:.1f}")
        console.print(places)
        if len(report.tight) > _SHOWN_PLACES:
            console.print(f"and {len(report.tight) - _SHOWN_PLACES} shorter ones")
    for note in notes:
        console.print(f"note: {note}")

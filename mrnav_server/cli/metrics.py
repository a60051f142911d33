"""``mrnav metrics``: the study's metrics of any trajectory in a CSV file."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from mrnav_server.core.errors import ConfigError

if TYPE_CHECKING:
    from mrnav_server.core.metrics import TrialMetrics


def metrics(
    file: Annotated[Path, typer.Argument(help="CSV with the columns t_s, x_um, y_um.")],
    sigma_um: Annotated[
        float | None,
        typer.Option(metavar="X", help="The tracker's noise in µm; judged from the file if left out."),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
) -> None:
    """Compute speed, time, straightness and smoothness of a trajectory, from its first to its last row."""
    import numpy as np

    from mrnav_server.core.metrics import Trial, trial_metrics
    from mrnav_server.core.noise_floor import noise_um
    from mrnav_server.study.trajectory_file import read_trajectory

    if sigma_um is not None and not 0.0 <= sigma_um < math.inf:
        raise ConfigError(f"--sigma-um must be a length in µm, 0 or more, not {sigma_um:g}")
    t_s, xy_um = read_trajectory(file)
    seen = np.isfinite(xy_um).all(axis=1)
    fresh = np.append(True, np.diff(t_s) > 0)
    noise = noise_um(t_s[seen & fresh], xy_um[seen & fresh]) if sigma_um is None else sigma_um
    found = trial_metrics(
        Trial(
            t_s=t_s,
            xy_um=xy_um,
            clearance_um=np.full(t_s.size, math.nan),
            go_s=float(t_s[0]),
            end_s=float(t_s[-1]),
            reached=True,
            sigma_um=noise,
        )
    )
    if json_output:
        typer.echo(json.dumps(_record(found)))
    else:
        _show(file, found, noise)


def _record(found: "TrialMetrics") -> dict[str, Any]:
    """Return the answer for programs; what the motion does not define is null."""
    values = {
        "va_um_per_s": found.average_speed_um_per_s,
        "toc_s": found.completion_s,
        "g": found.straightness.value,
        "s": found.smoothness.value,
        "ldlj": found.log_dimensionless_jerk,
        "sparc": found.spectral_arc_length,
    }
    defined = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return {**defined, "flags": list(found.flags)}


def _show(file: Path, found: "TrialMetrics", noise_um: float) -> None:
    from mrnav_server.core.metric_flags import FLAGS

    table = Table(title=f"{file.name}: {found.completion_s:.2f} s", title_justify="left")
    table.add_column("metric")
    table.add_column("value", justify="right")
    table.add_column("unit")
    table.add_column("better")
    g, s = found.straightness, found.smoothness
    for name, value, digits, unit, better in (
        ("Va, average speed", found.average_speed_um_per_s, 1, "µm/s", "higher"),
        ("TOC, first to last row", found.completion_s, 2, "s", "lower"),
        ("G, straightness", g.value, 3, "log10 of 1/µm", "lower is straighter"),
        ("S, smoothness", s.value, 3, "", "lower is smoother"),
        ("LDLJ", found.log_dimensionless_jerk, 3, "", "higher is smoother"),
        ("SPARC", found.spectral_arc_length, 3, "", "higher is smoother"),
        ("path", found.path_um, 0, "µm", ""),
        ("peak speed v_p", found.peak_speed_um_per_s, 1, "µm/s", ""),
        ("samples that move", 100.0 * g.moving_share, 0, "%", ""),
        ("G of the noise alone", found.straightness_floor, 2, "", ""),
        ("S of the noise alone", found.smoothness_floor, 2, "", ""),
        ("noise", noise_um, 2, "µm", ""),
    ):
        table.add_row(name, f"{value:.{digits}f}" if math.isfinite(value) else "–", unit, better)
    console = Console()
    console.print(table)
    for flag in found.flags:
        console.print(f"[yellow]{flag}:[/] {FLAGS[flag]}", highlight=False)

"""Draws a trial's path over its vessel."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from mrnav_server.core.arrays import BoolArray, FloatArray
from mrnav_server.core.contacts import contact_starts
from mrnav_server.core.vessel import VesselMap
from mrnav_server.study.trial_record import TrialRecord

# Okabe and Ito's colours, which colour-blind readers tell apart; line style and marker say it again.
_BLUE, _VERMILION, _GREEN, _GRAY = "#0072B2", "#D55E00", "#009E73", "#666666"
_DRIVERS = {"AUTO": ("autonomy", _BLUE, "-"), "MANUAL": ("operator", _VERMILION, "--")}
_NOBODY = ("held", _GRAY, ":")


def trajectory_figure(record: TrialRecord, clearance_um: FloatArray, vessel: VesselMap) -> Figure:
    """Draw the robot's path by who drove, the critical area, the contacts.

    Args:
        record: The trial.
        clearance_um: Gap to the wall at every track, shape (n,).
        vessel: Its vessel model.
    """
    mm_per_px = vessel.um_per_px / 1000.0
    size_mm = vessel.size_px * mm_per_px
    figure = Figure(figsize=(7.0, 7.6), layout="constrained")
    axes = figure.subplots()
    lumen = np.where(vessel.lumen, 1.0, 0.8)
    axes.imshow(lumen, cmap="gray", vmin=0.0, vmax=1.0, extent=(0.0, size_mm, size_mm, 0.0))
    xy_mm = record.vessel_px * mm_per_px
    _draw_path(axes, record, xy_mm)
    _draw_places(axes, record, mm_per_px)
    inside = record.inside
    touches = contact_starts(record.t_s[inside], clearance_um[inside])
    if touches:
        x_mm, y_mm = xy_mm[inside][touches].T
        axes.plot(x_mm, y_mm, "x", color="black", markersize=10, label=f"wall contact ({len(touches)})")
    simulated = ", simulated" if record.simulated else ""
    axes.set_title(
        f"Trial {record.id}{simulated}\n{vessel.name}, {record.header.condition.replace('_', ' ')}"
    )
    axes.set(xlabel="x / mm", ylabel="y / mm", xlim=(0.0, size_mm), ylim=(size_mm, 0.0))
    figure.legend(loc="outside lower center", ncols=5, fontsize="small", frameon=False)
    return figure


def _draw_path(axes: Axes, record: TrialRecord, xy_mm: FloatArray) -> None:
    drivers = [_DRIVERS.get(mode, _NOBODY) for mode in record.modes]
    for driver in (*_DRIVERS.values(), _NOBODY):
        drove: BoolArray = np.array([each == driver for each in drivers]) & record.inside
        if drove.any():
            # One sample more on the way in joins the pieces where the driver changes.
            drove[:-1] |= drove[1:] & record.inside[:-1]
            label, color, style = driver
            x_mm = np.where(drove, xy_mm[:, 0], np.nan)
            axes.plot(x_mm, xy_mm[:, 1], color=color, linestyle=style, linewidth=1.8, label=label)


def _draw_places(axes: Axes, record: TrialRecord, mm_per_px: float) -> None:
    header = record.header
    if header.start_px is not None:
        x_px, y_px = header.start_px
        axes.plot(x_px * mm_per_px, y_px * mm_per_px, "o", color=_GRAY, markersize=8, label="start")
    if header.area_px is not None and header.area_epsilon_um is not None:
        x_px, y_px = header.area_px
        axes.add_patch(
            Circle(
                (x_px * mm_per_px, y_px * mm_per_px),
                header.area_epsilon_um / 1000.0,
                fill=False,
                edgecolor=_GREEN,
                linewidth=2.0,
                label="critical area",
            )
        )

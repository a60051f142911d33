"""What a calibration under way has measured so far, in figures with the bounds that they must keep."""

from typing import Any

from mrnav_server.vision import floor_fit, magnet_fit, tip_fit
from mrnav_server.vision.calibration_file import HELD_OUT_MAX_UM
from mrnav_server.vision.calibration_parts import Draft
from mrnav_server.vision.calibration_procedure import STAGES


def draft_figures(draft: Draft | None) -> list[dict[str, Any]]:
    """Return the stages in order, for JSON: ``stage``, ``done`` and ``figures``.

    A figure has ``name``, ``value_um`` and ``bound_um``; a bound of None is for information alone.
    """
    return [
        {
            "stage": stage,
            "done": draft is not None and getattr(draft, stage) is not None,
            "figures": [
                {"name": name, "value_um": round(value, 2), "bound_um": bound}
                for name, value, bound in (_figures(draft, stage) if draft is not None else [])
            ],
        }
        for stage in STAGES
    ]


def _figures(draft: Draft, stage: str) -> list[tuple[str, float, float | None]]:
    if stage == "floor" and draft.floor is not None:
        floor = draft.floor.residuals
        return [
            ("RMS", floor.rms_um, floor_fit.RMS_MAX_UM),
            ("leave-one-out", floor.leave_one_out_um, None),
            ("maximum", floor.max_um, None),
        ]
    if stage == "tip" and draft.tip is not None:
        tip, held_out = draft.tip.residuals, draft.tip.held_out
        return [
            ("RMS", tip.rms_um, tip_fit.RMS_MAX_UM),
            ("leave-one-out", tip.leave_one_out_um, None),
            ("maximum", tip.max_um, tip_fit.MAX_UM),
            ("held out, maximum", held_out.max_um, HELD_OUT_MAX_UM),
        ]
    if stage == "height" and draft.height is not None:
        return [
            ("critical height", draft.height.critical_height_um, None),
            ("half the step", 0.5 * draft.height.step_um, None),
        ]
    if stage == "magnet" and draft.magnet is not None:
        return [
            ("approaches RMS", draft.magnet.rms_um, magnet_fit.RMS_MAX_UM),
            ("friction lead", draft.magnet.friction_lead_um, None),
        ]
    return []

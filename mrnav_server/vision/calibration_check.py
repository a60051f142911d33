"""The check that a session begins with: does the calibration still hold?"""

from collections.abc import Generator

import numpy as np

from mrnav_server.core.frames import StagePoint
from mrnav_server.vision.calibration_looks import (
    held_out_figures,
    held_out_points,
    located_tips,
    mean_gray,
    tip_at,
)
from mrnav_server.vision.calibration_parts import FloorPart, HeldOut, TipPart
from mrnav_server.vision.calibration_plan import (
    Answer,
    CalibrationConfig,
    MoveTip,
    Prepare,
    Step,
    TakePictures,
)


def check_tip(floor: FloorPart, tip: TipPart, config: CalibrationConfig) -> Generator[Step, Answer, HeldOut]:
    """Visit places that nothing was fitted to and see how far off the tip's map is: a session's first step.

    Returns:
        The errors; a session whose largest is above ``HELD_OUT_MAX_UM`` must not run.
    """
    yield Prepare("check", "Leave the plain plate under the camera, without a robot", 0.0, "plate")
    grays, tips = [], []
    places = held_out_points(config)
    for number, target in enumerate(places):
        share = number / len(places)
        above = StagePoint(target.x_um, target.y_um, config.travel_z_um)
        yield MoveTip("check", "Move the tip above its place", share, above, config.speed_um_per_s)
        yield MoveTip("check", "Lower the tip", share, target, config.descent_speed_um_per_s)
        seen = yield TakePictures("check", "Take pictures", share, config.pictures, config.settle_s)
        grays.append(mean_gray(seen))
        tips.append(tip_at(seen, target))
    hidden_um = floor.map.floor(located_tips(grays, tips))
    return held_out_figures(np.linalg.norm(tip.map.floor(np.array(tips)) - hidden_um, axis=1))

"""The guided calibration: says what is to be done next and is told what came of it. It does nothing itself.

Command line and dashboard host the same procedure. It is resumed by stage: each finished stage is a part of
the draft, which can be kept in a file, and a stage that was refused begins again.
"""

import math
from collections.abc import Generator
from dataclasses import asdict

import numpy as np

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.frames import ImagePoint, StagePoint
from mrnav_server.core.picture import PictureFormat
from mrnav_server.vision.calibration_looks import (
    RobotSight,
    grays_of,
    held_out_figures,
    held_out_points,
    located_tips,
    mean_gray,
    raster_points,
    tip_at,
)
from mrnav_server.vision.calibration_parts import (
    CameraPart,
    Draft,
    Figures,
    FloorPart,
    HeightPart,
    MagnetPart,
    TipPart,
    WaterPart,
)
from mrnav_server.vision.calibration_plan import (
    Answer,
    CalibrationConfig,
    MoveTip,
    Prepare,
    Step,
    TakePictures,
)
from mrnav_server.vision.charuco import find_sheet
from mrnav_server.vision.floor_fit import fit_floor
from mrnav_server.vision.magnet_fit import fit_height, fit_magnet
from mrnav_server.vision.residuals import Residuals
from mrnav_server.vision.tip_fit import fit_tip
from mrnav_server.vision.tracker import TrackerConfig

STAGES = ("floor", "tip", "height", "magnet")
_CONFIRMING_PICTURES = 6

Steps = Generator[Step, Answer, None]


class Procedure:
    """A calibration under way.

    Args:
        config: What it does.
        picture: The camera's pictures.
        tracker: How the robot is recognised.
        draft: What was measured before, to go on from; ignored if camera, water or sheet are others.

    Attributes:
        draft: What has been measured so far.
        step: What is to be done next; None once all is measured.
    """

    def __init__(
        self,
        config: CalibrationConfig,
        picture: PictureFormat,
        tracker: TrackerConfig,
        draft: Draft | None = None,
    ) -> None:
        empty = Draft(
            camera=CameraPart(width_px=picture.width_px, height_px=picture.height_px),
            water=WaterPart(depth_um=config.water_depth_um, index=config.water_index),
        )
        fits = draft is not None and (draft.camera, draft.water) == (empty.camera, empty.water)
        if draft is not None and draft.floor is not None:
            fits = fits and draft.floor.square_um == config.sheet.square_um
        self._config = config
        self._picture = picture
        self._tracker = tracker
        self.draft = draft if draft is not None and fits else empty
        self._steps: Steps
        self.step: Step | None
        self.restart()

    def restart(self) -> None:
        """Begin the first unfinished stage again."""
        self._at: StagePoint | None = None
        self._steps = self._run()
        self.step = next(self._steps, None)

    def told(self, answer: Answer) -> None:
        """Take the answer to ``step`` and go on to the next one.

        Raises:
            RefusedError: If what was measured is not good enough; the stage begins again.
        """
        try:
            self.step = self._steps.send(answer)
        except StopIteration:
            self.step = None
        except RefusedError:
            self.restart()
            raise

    def _run(self) -> Steps:
        for stage, run in zip(STAGES, (self._floor, self._tip, self._height, self._magnet), strict=True):
            if getattr(self.draft, stage) is None:
                yield from run()

    def _keep(self, **parts: object) -> None:
        self.draft = self.draft.model_copy(update=parts)

    def _floor(self) -> Steps:
        config, text = self._config, "Lay the sheet under the water, at the height of the robot's centre"
        yield Prepare("floor", f"{text}; raise the tip and bring it out of view", 0.0, "sheet")
        seen = yield TakePictures("floor", "Look at the sheet", 0.5, config.sheet_pictures, config.settle_s)
        corners = find_sheet(grays_of(seen), config.sheet)
        fit = fit_floor(corners, self._picture)
        self._keep(
            floor=FloorPart(
                homography=fit.map.homography,
                center_px=fit.map.center_px,
                radial=fit.map.radial,
                radius_px=fit.map.radius_px,
                square_um=config.sheet.square_um,
                coverage=fit.coverage,
                edge_sigma_um=fit.edge_sigma_um,
                residuals=_figures(fit.residuals),
            )
        )

    def _tip(self) -> Steps:
        assert self.draft.floor is not None
        text = "Put the plain plate in the sheet's place, under the same water; no robot near"
        yield Prepare("tip", text, 0.0, "plate")
        raster = raster_points(self._config)
        held_out = held_out_points(self._config)
        grays, tips = [], []
        for number, target in enumerate([*raster, *held_out]):
            share = number / (len(raster) + len(held_out))
            yield from self._travel("tip", share, target)
            seen = yield self._look("tip", share)
            grays.append(mean_gray(seen))
            tips.append(tip_at(seen, target))
        hidden_um = self.draft.floor.map.floor(located_tips(grays, tips))
        count = len(raster)
        fit = fit_tip(np.array(tips[:count]), hidden_um[:count])
        misses = np.linalg.norm(fit.map.floor(np.array(tips[count:])) - hidden_um[count:], axis=1)
        self._keep(
            tip=TipPart(
                matrix=fit.map.matrix,
                offset_um=fit.map.offset,
                camera_z_um=fit.map.camera_z_um,
                heights_z_um=self._config.raster_z_um,
                residuals=_figures(fit.residuals),
                held_out=held_out_figures(misses),
            )
        )

    def _height(self) -> Steps:
        config, sight = self._config, self._sight()
        yield from self._travel("height", 0.0, self._parking()[0])
        yield Prepare("height", "Put the robot on the middle of the plate", 0.0, "robot")
        robot = yield from self._robot("height", 0.0, sight)
        x_um, y_um = self._over(robot, sight)
        z_um = config.travel_z_um
        yield from self._travel("height", 0.1, StagePoint(x_um, y_um, z_um))
        stops: list[float] = []
        lay: list[bool] = []
        while z_um > config.descent_to_z_um and all(lay):
            share = 0.1 + 0.8 * (config.travel_z_um - z_um) / (config.travel_z_um - config.descent_to_z_um)
            target = StagePoint(x_um, y_um, z_um)
            yield MoveTip("height", "Lower the magnet", share, target, config.descent_speed_um_per_s)
            seen = yield TakePictures("height", "See whether the robot lies", share, 2, 0.2)
            there = sight.robot(seen) is not None
            if not there:
                seen = yield TakePictures("height", "Look again", share, _CONFIRMING_PICTURES, 0.0)
                there = sight.robot(seen) is not None
            if there or lay:
                stops.append(tip_at(seen, target)[2])
                lay.append(there)
            self._at = target
            z_um -= config.descent_step_um
        if not all(lay):
            found = yield from self._seen_from_aside("height", 0.95, sight)
            if found is not None:
                raise RefusedError(
                    "hidden",
                    "the needle hid the robot, which did not jump: correct calibration.rough_offset_um, so"
                    " that the robot rests ahead of the magnet, and descend once more",
                )
        fit = fit_height(np.array(stops), lay, sight.calibration.floor_z_um)
        self._keep(
            height=HeightPart(
                floor_z_um=sight.calibration.floor_z_um,
                critical_height_um=fit.critical_height_um,
                step_um=fit.step_um,
                jump_z_um=fit.jump_z_um,
            )
        )

    def _magnet(self) -> Steps:
        assert self.draft.height is not None
        config, sight = self._config, self._sight()
        height_um = config.height_factor * self.draft.height.critical_height_um
        z_um = self.draft.height.floor_z_um + height_um
        yield from self._travel("magnet", 0.0, self._parking()[0])
        text = "Take the robot off the magnet and put it back on the middle of the plate"
        yield Prepare("magnet", text, 0.0, "robot")
        robot = yield from self._robot("magnet", 0.0, sight)
        x_um, y_um = self._over(robot, sight)
        yield from self._travel("magnet", 0.05, StagePoint(x_um, y_um, z_um))
        gaps, headings = [], []
        for number in range(config.approaches):
            share = 0.1 + 0.9 * number / config.approaches
            angle = 2.0 * math.pi * number / config.approaches
            heading = np.array([math.cos(angle), math.sin(angle)])
            begin = np.array([x_um, y_um]) - config.approach_run_um * heading
            speed = config.approach_speed_um_per_s
            text = f"Approach {number + 1} of {config.approaches}"
            yield MoveTip("magnet", text, share, StagePoint(float(begin[0]), float(begin[1]), z_um), speed)
            target = StagePoint(x_um, y_um, z_um)
            yield MoveTip("magnet", text, share, target, speed)
            seen = yield TakePictures("magnet", text, share, config.pictures + 2, 4.0 * config.settle_s)
            self._at = target
            found = sight.robot(seen)
            if found is None:
                raise RefusedError(
                    "no_robot", "the robot was not seen under the magnet: clear the view, try again"
                )
            tip_um = tip_at(seen, target)
            gaps.append(np.array(tip_um[:2]) - sight.stage_um(found))
            headings.append(heading)
        fit = fit_magnet(np.array(gaps), np.array(headings))
        yield from self._raise("magnet", 1.0, StagePoint(x_um, y_um, config.travel_z_um))
        self._keep(
            magnet=MagnetPart(
                offset_um=fit.offset_um,
                friction_lead_um=fit.friction_lead_um,
                approaches=fit.approaches,
                rms_um=fit.rms_um,
                height_um=height_um,
            )
        )

    def _travel(self, stage: str, share: float, target: StagePoint) -> Steps:
        """Go to a place from above: straight up, across, straight down."""
        if self._at is not None and self._at.z_um < self._config.travel_z_um:
            yield from self._raise(stage, share, self._at)
        above = StagePoint(target.x_um, target.y_um, self._config.travel_z_um)
        yield MoveTip(stage, "Move the tip above its place", share, above, self._config.speed_um_per_s)
        if target.z_um < above.z_um:
            yield MoveTip(stage, "Lower the tip", share, target, self._config.descent_speed_um_per_s)
        self._at = target

    def _raise(self, stage: str, share: float, place: StagePoint) -> Steps:
        """Go straight up to where the tip travels."""
        above = StagePoint(place.x_um, place.y_um, self._config.travel_z_um)
        yield MoveTip(stage, "Raise the tip", share, above, self._config.descent_speed_um_per_s)
        self._at = above

    def _look(self, stage: str, share: float) -> TakePictures:
        return TakePictures(stage, "Take pictures", share, self._config.pictures, self._config.settle_s)

    def _robot(self, stage: str, share: float, sight: RobotSight) -> Generator[Step, Answer, ImagePoint]:
        """Find the robot, from a parking place from which the needle does not hide it."""
        found = yield from self._seen_from_aside(stage, share, sight)
        if found is None:
            raise RefusedError(
                "no_robot", "no robot was seen on the plate: put it in the middle, in good light"
            )
        return found

    def _seen_from_aside(
        self, stage: str, share: float, sight: RobotSight
    ) -> Generator[Step, Answer, ImagePoint | None]:
        for place in self._parking():
            yield from self._travel(stage, share, place)
            text, settle_s = "Look for the robot", self._config.settle_s
            seen = yield TakePictures(stage, text, share, _CONFIRMING_PICTURES, settle_s)
            found = sight.robot(seen)
            if found is not None:
                return found
        return None

    def _over(self, robot: ImagePoint, sight: RobotSight) -> tuple[float, float]:
        """Return where the tip about holds a robot, stage x, y."""
        (x_um, y_um), (dx_um, dy_um) = sight.stage_um(robot), self._config.rough_offset_um
        return x_um + dx_um, y_um + dy_um

    def _parking(self) -> list[StagePoint]:
        """Return the raster's corners, high up, from where the magnet moves no robot in the middle."""
        (cx, cy), half = self._config.raster_center_um, self._config.raster_span_um / 2.0
        corners = ((1, -1), (1, 1), (-1, -1), (-1, 1))
        return [StagePoint(cx + i * half, cy + j * half, self._config.travel_z_um) for i, j in corners]

    def _sight(self) -> RobotSight:
        assert self.draft.floor is not None
        assert self.draft.tip is not None
        return RobotSight(self.draft.floor, self.draft.tip, self.draft.water, self._tracker)


def _figures(residuals: Residuals) -> Figures:
    return Figures.model_validate(asdict(residuals))

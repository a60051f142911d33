"""Which law brings the robot to its target, by the settings."""

from mrnav_server.autonomy.direct import ActionConfig, DirectLaw
from mrnav_server.autonomy.follower import Follower
from mrnav_server.autonomy.following import FollowerConfig, Law
from mrnav_server.autonomy.policy import Policy
from mrnav_server.core.frames import Calibration
from mrnav_server.core.vessel import VesselMap
from mrnav_server.loops.autopilot import AutopilotConfig


def new_law(
    config: AutopilotConfig,
    follower: FollowerConfig,
    policy: Policy | None,
    vessel: VesselMap,
    calibration: Calibration,
) -> Law:
    """Return a law that has learnt nothing yet; the follower, too, where there is no policy to ask."""
    if config.law == "path" or policy is None:
        return Follower(follower, vessel, calibration)
    actions = ActionConfig(config.actions_per_s, config.greedy, config.seed)
    return DirectLaw(follower, actions, policy, vessel, calibration)

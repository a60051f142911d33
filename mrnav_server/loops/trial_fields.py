"""What a log says of a hand sample and of a track, and back; nothing is rounded, for an exact replay."""

from collections.abc import Mapping
from typing import Any

from mrnav_server.core.frames import HandPoint, ImagePoint, VesselPoint
from mrnav_server.core.hand_stream import HandSample
from mrnav_server.core.records import Track, TrackState


def hand_fields(sample: HandSample) -> dict[str, Any]:
    """Return a hand sample for the log."""
    point = sample.point
    return {
        "seq": sample.seq,
        "sender_s": sample.sender_t_s,
        "received_s": sample.received_s,
        "p_m": (point.x_m, point.y_m, point.z_m),
        "clutch": sample.clutch,
        "valid": sample.valid,
        "new_pose": sample.new_pose,
    }


def hand_sample(fields: Mapping[str, Any]) -> HandSample:
    """Return the sample of a log's line; whose it was is not recorded."""
    # What was not finite is null in the log, and was counted and left out by the hand's control.
    numbers = [float("nan") if each is None else each for each in (*fields["p_m"], fields["sender_s"])]
    return HandSample(
        "recorded",
        fields["seq"],
        numbers[3],
        fields["received_s"],
        HandPoint(*numbers[:3]),
        fields["clutch"],
        fields["valid"],
        fields["new_pose"],
    )


def track_fields(track: Track) -> dict[str, Any]:
    """Return a track for the log."""
    image, vessel = track.image, track.vessel
    return {
        "frame": track.frame_number,
        "taken_s": track.taken_s,
        "state": track.state.value,
        "image": None if image is None else (image.x_px, image.y_px),
        "vessel": None if vessel is None else (vessel.x_px, vessel.y_px),
        "confidence": float(track.confidence),
        "sigma_um": float(track.sigma_um),
        "good_frames": track.good_frames,
    }


def track_of(fields: Mapping[str, Any]) -> Track:
    """Return the track of a log's line."""
    image, vessel, sigma_um = fields["image"], fields["vessel"], fields["sigma_um"]
    return Track(
        fields["taken_s"],
        fields["frame"],
        TrackState(fields["state"]),
        None if image is None else ImagePoint(*image),
        None if vessel is None else VesselPoint(*vessel),
        fields["confidence"],
        float("nan") if sigma_um is None else sigma_um,
        fields["good_frames"],
    )

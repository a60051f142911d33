"""The beginning of a trial's log, for tests in which little of it matters."""

from mrnav_server.loops.trial_log import Condition, TrialHeader


def bare_header(participant: str, condition: Condition, vessel: str) -> TrialHeader:
    """A person's trial on a simulated rig, without start and area."""
    return TrialHeader(
        participant=participant,
        condition=condition,
        operator_kind="human",
        simulated_rig=True,
        software_version="1",
        configuration_sha256="",
        vessel=vessel,
        vessel_sha256="",
        um_per_px=10.0,
        calibration={},
        start_px=None,
        area_id=None,
        area_px=None,
        area_epsilon_um=None,
    )

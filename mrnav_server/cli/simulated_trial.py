"""One trial of a simulated operator over the real sockets: the console's part, in real or virtual time."""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mrnav_server.autonomy.grid_graph import GridGraph
from mrnav_server.cli.console import TrialFailedError, TwinConsole
from mrnav_server.cli.trial_steps import ARMED_S, SEATED_S, ask_auto, insist, wait_tracking
from mrnav_server.client.rest import Rest
from mrnav_server.client.waiting import Waiting
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap
from mrnav_server.sim.operator import Condition
from mrnav_server.vision.model_store import find_model
from mrnav_server.vision.vessel_model import load_vessel_model

WAY_UM = 27_000.0
"""The target lies about so far along the vessel, or as far as there is."""
ROOM_UM = 300.0
TRIAL_S = 100.0
REPORT_S = 150.0
AUTO_ASKS = 4
TARGET = {"MRNAV_TRIAL__TARGET_UM": "200.0", "MRNAV_TRIAL__DWELL_S": "0.2"}

SitDown = Callable[[str], AbstractContextManager[Callable[[], None]]]
"""Has the operator sit down for a critical area; gives what raises TrialFailedError once it has gone."""


@dataclass(frozen=True, slots=True)
class SimulatedTrial:
    """What is to be done.

    Attributes:
        operator: Which simulated operator: the seed of its person.
        repetition: Which repetition; trials of one repetition meet the same friction, whatever the condition.
        practice: How many trials the operator has done before.
        condition: With or without autonomy.
        model: Vessel model.
        epsilon_um: Radius of the critical area in µm.
        code: Under which code the trial is recorded.
        notes: Free text of its record.
        variables: Further settings, as ``MRNAV_`` variables.
    """

    operator: int
    repetition: int
    practice: int
    condition: Condition
    model: str
    epsilon_um: float
    code: str
    notes: str
    variables: Mapping[str, str] = field(default_factory=dict)

    @property
    def noise(self) -> int:
        """Seed of everything that the operator draws by chance in this trial."""
        return 1000 * self.operator + self.repetition

    def environment(self, root: str) -> dict[str, str]:
        """Return the settings of the trial's server as variables.

        Args:
            root: Folder that gets the trial's own.
        """
        # The same operator meets the same friction in both conditions.
        chance = np.random.default_rng([self.operator, self.repetition, 77])
        return {
            "MRNAV_SERVER__HOST": "127.0.0.1",
            "MRNAV_SERVER__PORT": "0",
            "MRNAV_SERVER__HAND_PORT": "0",
            "MRNAV_RIG__VESSEL": self.model,
            "MRNAV_RECORDING__ROOT": root,
            "MRNAV_SIM__SEED": str(100 * self.operator + self.repetition),
            "MRNAV_SIM__FRICTION": f"{0.2 * math.exp(chance.normal(0.0, 0.05)):.4f}",
            **TARGET,
            **self.variables,
        }


def far_site(vessel: VesselMap, start: VesselPoint) -> VesselPoint:
    """Return the roomy place whose way from the start is nearest to 27 mm."""
    graph = GridGraph(vessel, cell_px=8)
    way_um = graph.distances_px(start) * vessel.um_per_px
    places = [VesselPoint(float(x), float(y)) for x, y in graph.nodes_px]
    roomy = [
        i for i in np.flatnonzero(np.isfinite(way_um)).tolist() if vessel.clearance_um(places[i]) >= ROOM_UM
    ]
    return places[min(roomy, key=lambda i: abs(float(way_um[i]) - WAY_UM))]


def lead_trial(
    trial: SimulatedTrial, url: str, token: str, sit_down: SitDown, waiting: Waiting
) -> dict[str, Any]:
    """Lead a server that has just started through one trial, as an experimenter at its console would.

    Args:
        trial: What is to be done.
        url: The server's web address.
        token: An operator's token.
        sit_down: Has the operator sit down.
        waiting: How it waits.

    Returns:
        ``completed``, ``reason`` and what the server answered at the trial's end.

    Raises:
        MrnavError: If the trial cannot even begin.
    """
    rest = Rest(url, token, timeout_s=REPORT_S, waiting=waiting)
    vessel = load_vessel_model(find_model(trial.model))
    site = far_site(vessel, VesselPoint(*wait_tracking(rest)["robot_vessel_px"]))
    center = {"frame": "vessel", "x": site.x_px, "y": site.y_px}
    area = rest.post("/api/v1/critical-areas", {"center": center, "epsilon_um": trial.epsilon_um})["id"]
    with sit_down(area) as alive, TwinConsole(url, token, alive, waiting) as twin:
        console = Rest(url, token, twin.snapshot["session"], waiting=waiting)
        console.post("/api/v1/lease", {"client": "simulated study"})
        twin.until(lambda s: bool(s["lease"]["hand"]), SEATED_S, "the operator's hand link")
        begun = console.post(
            "/api/v1/trials",
            {
                "participant": trial.code,
                "condition": trial.condition,
                "operator_kind": "simulated",
                "notes": trial.notes,
            },
        )
        reason = _perform(trial.condition, console, twin, area)
        if twin.state["mode"] in ("MANUAL", "HOLD", "AUTO"):
            console.post("/api/v1/mode", {"ask": "disarm"})
    ended: dict[str, Any] = rest.post(f"/api/v1/trials/{begun['id']}/end", {})
    completed = not reason and "metrics" in ended
    return {"completed": completed, "reason": reason or ended.get("report_error", ""), "ended": ended}


def _perform(condition: Condition, rest: Rest, twin: TwinConsole, area: str) -> str:
    """Let the trial happen; return why it failed, or ""."""
    insist(rest, twin, "arm")
    twin.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), ARMED_S, "arming")

    def happened(name: str, mark: str | None = None) -> bool:
        return any(e["event"] == name and e.get("mark") == mark for e in twin.events)

    try:
        asks = AUTO_ASKS if condition == "with_autonomy" else 0
        for _ in range(asks):
            ask_auto(rest, twin, area)
            twin.until(lambda s: s["mode"] == "AUTO" or happened("handover"), ARMED_S, "AUTO")
            twin.until(lambda s: s["mode"] != "AUTO", TRIAL_S, "autonomy")
            if happened("handover") or twin.state["mode"] != "HOLD":
                break
            twin.wait(1.0)
        if asks and not happened("handover"):
            return f"autonomy ended in {twin.state['mode']}: {twin.state['reason']}"
        twin.until(
            lambda s: happened("trial", "reached") or s["mode"] in ("FAULT", "STOP"), TRIAL_S, "the target"
        )
        if not happened("trial", "reached"):
            return f"{twin.state['mode']}: {twin.state['reason']}"
        twin.wait(1.0)
    except TrialFailedError as error:
        return str(error)
    return ""

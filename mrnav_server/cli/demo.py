"""``mrnav demo``: one semi-autonomous trial, server and simulated operator each a process of its own.

Everything goes through the sockets that a headset and a dashboard use.
"""

import json
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.console import Console

from mrnav_server.cli.children import Child, mrnav_child
from mrnav_server.cli.console import State, TrialFailedError, TwinConsole
from mrnav_server.cli.demo_result import Tally, empty_result, note_end, note_states, result_table
from mrnav_server.cli.emulated import emulated_controller
from mrnav_server.cli.trial_steps import ARMED_S, SEATED_S, ask_auto, insist, wait_ready, wait_tracking
from mrnav_server.client.rest import Rest, RestError
from mrnav_server.core.errors import MrnavError
from mrnav_server.core.frames import VesselPoint
from mrnav_server.core.vessel import VesselMap

AUTO_S = 60.0
FINISH_S = 90.0
REPORT_S = 150.0
TARGET_UM = 150.0
STAYS_S = 0.5
SHORTEST_UM = 4000.0
CLEARANCE_UM = 200.0
_AUTO_ASKS = 4
_RANDOM_SITES = 6


def demo(
    model: Annotated[str, typer.Option(help="Vessel model: a name or a folder.")] = "bifurcation",
    seed: Annotated[int, typer.Option(min=0, help="Seed of rig, target and operator.")] = 0,
    manipulator: Annotated[
        Literal["simulated", "sensapex-udp", "sensapex-sdk"] | None,
        typer.Option(help="Driver; sensapex drives an emulated controller. The settings' if left out."),
    ] = None,
    json_output: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line.")
    ] = False,
    keep_open: Annotated[bool, typer.Option("--keep-open", help="Keep the server until Ctrl-C.")] = False,
    trials: Annotated[Path | None, typer.Option(help="Folder for the trial; a new one if left out.")] = None,
) -> None:
    """Let a simulated operator do one semi-autonomous trial on the simulated rig."""
    # A terminating signal must unwind the stack, so that the child processes end with this one.
    signal.signal(signal.SIGTERM, _exit)
    root = trials or Path(tempfile.mkdtemp(prefix="mrnav-demo-"))
    root.mkdir(parents=True, exist_ok=True)
    result = _run(model, seed, root.resolve(), keep_open, manipulator)
    page = Console(stderr=json_output, highlight=False)
    page.print(result_table(result))
    page.print(f"modes: {' → '.join(result['mode_history'])}")
    page.print(f"result: {result['reason']}", markup=False)
    page.print(f"log and trajectory picture: {result['trial_dir']}", markup=False, soft_wrap=True)
    if json_output:
        typer.echo(json.dumps(result))
    raise typer.Exit(0 if result["completed"] else 1)


def choose_site(vessel: VesselMap, start: VesselPoint, seed: int) -> VesselPoint:
    """Return where the critical area goes, drawn from the suggested and some random sites.

    Args:
        vessel: The vessel model.
        start: Where the robot is.
        seed: Same seed, same site.

    Raises:
        TrialFailedError: If the vessel has no site that is far enough and has clearance.
    """
    from mrnav_server.autonomy.grid_graph import GridGraph

    graph = GridGraph(vessel, cell_px=8)
    way_um = graph.distances_px(start) * vessel.um_per_px

    def suits(node: int) -> bool:
        x_px, y_px = (float(v) for v in graph.nodes_px[node])
        roomy = vessel.clearance_um(VesselPoint(x_px, y_px)) >= CLEARANCE_UM
        return roomy and SHORTEST_UM <= way_um[node] < np.inf

    rng = np.random.default_rng(seed)
    sites = [site for site in vessel.suggested_areas if suits(graph.nearest(site.x_px, site.y_px))]
    fitting = [node for node in range(len(graph.nodes_px)) if suits(node)]
    for node in rng.choice(fitting, min(_RANDOM_SITES, len(fitting)), replace=False) if fitting else ():
        x_px, y_px = graph.nodes_px[node]
        sites.append(VesselPoint(float(x_px), float(y_px)))
    if not sites:
        raise TrialFailedError(f"{vessel.name}: no site is {SHORTEST_UM:.0f} µm away and has clearance")
    return sites[int(rng.integers(len(sites)))]


def _run(model: str, seed: int, root: Path, keep_open: bool, manipulator: str | None) -> dict[str, Any]:
    from mrnav_server.vision.model_store import find_model
    from mrnav_server.vision.vessel_model import load_vessel_model

    result = empty_result(model, seed, str(root))
    say = Console(stderr=True, highlight=False)
    env = {
        "MRNAV_SERVER__HOST": "127.0.0.1",
        "MRNAV_SERVER__PORT": "0",
        "MRNAV_SERVER__HAND_PORT": "0",
        "MRNAV_RIG__VESSEL": model,
        "MRNAV_RECORDING__ROOT": str(root),
        "MRNAV_SIM__SEED": str(seed),
    }
    if manipulator is not None:
        env["MRNAV_MANIPULATOR__DRIVER"] = manipulator
    with (
        tempfile.TemporaryDirectory(prefix="mrnav-demo-") as scratch_name,
        say.status("starting") as status,
        ExitStack() as emulation,
    ):
        scratch = Path(scratch_name)
        ready_file = scratch / "ready.json"
        serve = ["serve", "--ready-file", str(ready_file)]
        try:
            vessel = load_vessel_model(find_model(model))
            if manipulator in ("sensapex-udp", "sensapex-sdk"):
                env |= emulation.enter_context(emulated_controller(env, scratch))
                say.print(
                    f"{manipulator}: an emulated controller on UDP group {env['MRNAV_SENSAPEX__GROUP']}"
                )
            with mrnav_child("the server", serve, env, scratch / "serve") as server:
                ready = wait_ready(ready_file, server)
                url, token = f"http://127.0.0.1:{ready['port']}", ready["operator_token"]
                say.print(f"the server (simulated rig) is ready: {ready['url']}", soft_wrap=True)
                area = _mark_site(Rest(url, token), vessel, seed)
                sit = ["operator", "--port", str(ready["hand_port"]), "--url", url, "--seed", str(seed)]
                secret = {"MRNAV_SERVER__OPERATOR_TOKEN": token}
                with mrnav_child("the operator", sit, secret, scratch / "operator") as operator:
                    with _console(url, token, server, operator) as twin:
                        twin.watch(lambda state: status.update(_line(state)))
                        twin.watch_modes(lambda state: say.print(_line(state), markup=False))
                        trial = _trial(Rest(url, token, twin.snapshot["session"]), twin, area, seed, result)
                    status.update("computing the metrics (simulated)")
                    note_end(Rest(url, token, timeout_s=REPORT_S).post(f"{trial}/end", {}), result)
                    if keep_open:
                        status.stop()
                        say.print(f"{result['reason']}; Ctrl-C ends the server")
                        _stay(server)
        except (MrnavError, OSError) as error:
            result["completed"], result["reason"] = False, str(error)
    return result


def _mark_site(rest: Rest, vessel: VesselMap, seed: int) -> str:
    """Wait for the robot to be seen, mark a critical area and return its id."""
    state = wait_tracking(rest)
    site = choose_site(vessel, VesselPoint(*state["robot_vessel_px"]), seed)
    center = {"frame": "vessel", "x": site.x_px, "y": site.y_px}
    area = rest.post("/api/v1/critical-areas", {"center": center, "epsilon_um": 500.0, "label": "thrombus"})
    marked: str = area["id"]
    return marked


def _trial(rest: Rest, twin: TwinConsole, area: str, seed: int, result: dict[str, Any]) -> str:
    """Run the trial, note what happened, and return its REST path; it is not ended yet."""
    rest.post("/api/v1/lease", {"client": "demonstration"})
    twin.until(lambda s: bool(s["lease"]["hand"]), SEATED_S, "the operator's hand link")
    trial = rest.post(
        "/api/v1/trials",
        {
            "participant": f"SIM{seed}",
            "condition": "with_autonomy",
            "operator_kind": "simulated",
            "notes": f"mrnav demo, seed {seed}: simulated operator on the simulated rig",
        },
    )
    result["trial_dir"] = trial["folder"]
    tally = Tally()
    twin.watch(tally.note)
    try:
        _perform(rest, twin, tally, area)
    except (TrialFailedError, RestError) as error:
        result["reason"] = str(error)
    else:
        result["completed"], result["reason"] = True, "target reached"
    note_states(twin, tally, result)
    if result["completed"]:
        rest.post("/api/v1/mode", {"ask": "disarm"})
    return f"/api/v1/trials/{trial['id']}"


def _perform(rest: Rest, twin: TwinConsole, tally: Tally, area: str) -> None:
    """Arm, let the autonomy drive, and wait until the operator lets go of the robot."""
    for _ in range(_AUTO_ASKS):
        if twin.state["mode"] not in ("MANUAL", "HOLD"):
            insist(rest, twin, "arm")
            twin.until(lambda s: s["mode"] in ("MANUAL", "HOLD"), ARMED_S, "arming")
        tally.drove = False
        ask_auto(rest, twin, area)
        twin.until(lambda _: tally.drove, ARMED_S, "AUTO")
        twin.until(lambda s: s["mode"] != "AUTO", AUTO_S, "autonomy")
        if twin.state["mode"] not in ("HOLD", "FAULT"):
            break
        twin.wait(1.0)  # whatever held the rig may pass
        if twin.state["mode"] == "FAULT":
            # As an operator would who has read the reason: on a busy machine the server misses its ticks.
            tally.drove = False
            insist(rest, twin, "reset")
    if not tally.handed_over:
        raise TrialFailedError(f"autonomy ended in {twin.state['mode']}: {twin.state['reason']}")

    let_go_s: float | None = None

    def finished(state: State) -> bool:
        nonlocal let_go_s
        distance_um = state["distance_um"]
        there = distance_um is not None and distance_um <= TARGET_UM
        # A hand that grips anew opens the clutch too, and a robot may still slide on.
        if not (tally.gripped and there and not state["clutch"] and state["mode"] == "MANUAL"):
            let_go_s = None
        elif let_go_s is None:
            let_go_s = state["t"]
        return let_go_s is not None and state["t"] - let_go_s >= STAYS_S

    twin.until(finished, FINISH_S, "the operator's part")


@contextmanager
def _console(url: str, token: str, *children: Child) -> Iterator[TwinConsole]:
    def alive() -> None:
        for child in children:
            child.check()

    with TwinConsole(url, token, alive) as twin:
        yield twin


def _stay(server: Child) -> None:
    try:
        while True:
            server.check()
            time.sleep(0.5)
    except KeyboardInterrupt:
        return


def _exit(number: int, _: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _line(state: State) -> str:
    parts = [f"{state['mode']} (simulated)"]
    if state["distance_um"] is not None:
        parts.append(f"{state['distance_um']:.0f} µm to the critical area's centre")
    if state["reason"]:
        parts.append(state["reason"])
    return ", ".join(parts)

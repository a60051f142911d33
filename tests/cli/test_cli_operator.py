"""The operator's process: what it knows of the vessel, and what it makes of the twin and its events."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from mrnav_server.cli import operator as module
from mrnav_server.cli.operator import Desk, Seat, operator
from mrnav_server.cli.operator_chart import Chart
from mrnav_server.client.errors import ConnectionEndedError
from mrnav_server.client.rest import Rest
from mrnav_server.core.frames import HandPoint
from mrnav_server.core.modes import Mode
from mrnav_server.sim.operator import MODEL_NAME, HandPose, Phase, Sight
from mrnav_server.sim.operator_route import Route
from mrnav_server.sim.virtual_time import AtOnce

AREA = {"id": "area-1", "center": {"x_px": 800.0, "y_px": 300.0}}
SNAPSHOT: dict[str, Any] = {
    "vessel": {"name": "channel", "um_per_px": 10.0, "robot_radius_um": 500.0},
    "calibration": {"stage_from_vessel": [[10.0, 0.0, 1000.0], [0.0, 10.0, 2000.0]]},
    "critical_areas": [AREA],
}
TWIN: dict[str, Any] = {
    "type": "twin",
    "mode": "AUTO",
    "critical_area": "area-1",
    "robot_um": [2000.0, 5000.0],
    "robot_vessel_px": [100.0, 300.0],
    "authority": 0.25,
    "time_to_handover_s": 4.0,
}


class PictureRest(Rest):
    """Has the picture of a channel."""

    def __init__(self) -> None:
        super().__init__("http://127.0.0.1:9", "secret")

    def get_bytes(self, path: str) -> bytes:
        assert path == "/api/v1/vessel.png"
        mask = np.zeros((900, 900), dtype=np.uint8)
        mask[200:400, 20:880] = 255
        encoded, content = cv2.imencode(".png", mask)
        assert encoded
        return content.tobytes()


@pytest.fixture(scope="module")
def chart() -> Chart:
    return Chart(PictureRest(), SNAPSHOT)


def test_its_way_leads_along_the_middle_to_the_very_target(chart: Chart) -> None:
    route = chart.route((100.0, 260.0), {"x_px": 800.0, "y_px": 310.0})
    assert route is not None
    assert route.target_um.tolist() == pytest.approx([9000.0, 5100.0])
    assert route.length_um == pytest.approx(7000.0, rel=0.02)
    _, y_um = route.point_um(route.length_um / 2)
    assert y_um == pytest.approx(5000.0, abs=50.0)
    assert route.clearance_um(3000.0, 4000.0) == pytest.approx(500.0, abs=50.0)


class Watcher:
    """Stands in for the operator: keeps what it is shown."""

    def __init__(self) -> None:
        self.sights: list[Sight] = []
        self.routes: list[Route | None] = []
        self.phase = Phase.WATCHING
        self.regrips = 3

    def know(self, route: Route | None) -> None:
        self.routes.append(route)

    def see(self, sight: Sight) -> None:
        self.sights.append(sight)

    def hand(self, now_s: float) -> HandPose:
        return HandPose(0, HandPoint(0.0, 0.0, 0.0), clutch=False)


class FakeLink:
    """A hand link that shows fixed twins and then hangs up."""

    twins_left: list[dict[str, Any]]

    def __init__(self, *_: object, **__: object) -> None:
        self.sent: list[bool] = []

    def __enter__(self) -> "FakeLink":
        return self

    def __exit__(self, *_: object) -> None:
        return

    def send(self, _: object, *, clutch: bool, pose: int) -> None:
        self.sent.append(clutch)

    def ping(self) -> None:
        return

    def twins(self, for_s: float) -> Iterator[dict[str, Any]]:
        if not self.twins_left:
            raise ConnectionEndedError("the server closed the hand link")
        yield self.twins_left.pop(0)


class FakeTwin:
    """A twin with fixed events, all in the first second."""

    events_left: list[dict[str, Any]]
    snapshot = SNAPSHOT

    def __init__(self, *_: object, **__: object) -> None:
        return

    def __enter__(self) -> "FakeTwin":
        return self

    def __exit__(self, *_: object) -> None:
        return

    def take(self, _: float) -> dict[str, Any] | None:
        return self.events_left.pop(0) if self.events_left else None


def worked(
    monkeypatch: pytest.MonkeyPatch, chart: Chart, twins: list[dict[str, Any]], events: list[dict[str, Any]]
) -> tuple[Watcher, Desk]:
    class FakeChart:
        def __init__(self, *_: object) -> None:
            self.route = chart.route

    watcher = Watcher()
    monkeypatch.setattr(module, "HandLink", FakeLink)
    monkeypatch.setattr(module, "Twin", FakeTwin)
    monkeypatch.setattr(module, "Chart", FakeChart)
    FakeLink.twins_left, FakeTwin.events_left = list(twins), list(events)
    desk = Desk(Seat("host", 1, "http://host", "secret"), watcher, AtOnce())  # type: ignore[arg-type]
    with pytest.raises(ConnectionEndedError):
        desk.work(7, "with_autonomy", once=False)
    assert desk.seated
    return watcher, desk


def test_it_shows_the_operator_the_twin_and_the_way(monkeypatch: pytest.MonkeyPatch, chart: Chart) -> None:
    watcher, _ = worked(monkeypatch, chart, [TWIN | {"mode": "MANUAL"}] * 4, [])
    assert all(sight.mode is Mode.MANUAL for sight in watcher.sights)
    assert watcher.sights[0].robot_um == (2000.0, 5000.0)
    assert watcher.sights[0].authority == 0.25
    assert watcher.sights[0].handover_in_s is None
    (route,) = watcher.routes
    assert route is not None
    assert route.target_um.tolist() == pytest.approx([9000.0, 5000.0])


def test_while_the_autonomy_drives_it_looks_for_no_way(monkeypatch: pytest.MonkeyPatch, chart: Chart) -> None:
    watcher, _ = worked(monkeypatch, chart, [TWIN] * 4, [])
    assert watcher.routes == []
    told = {"type": "event", "event": "handover_announced", "in_s": 1.5}
    watcher, _ = worked(monkeypatch, chart, [TWIN] * 4, [told])
    assert len(watcher.routes) == 1


def test_only_an_announced_handover_has_a_countdown(monkeypatch: pytest.MonkeyPatch, chart: Chart) -> None:
    told = {"type": "event", "event": "handover_announced", "in_s": 1.5}
    shown = [TWIN, TWIN | {"time_to_handover_s": None}, TWIN | {"mode": "MANUAL"}]
    watcher, _ = worked(monkeypatch, chart, shown, [told])
    first, second, third = (sight.handover_in_s for sight in watcher.sights)
    assert first == 4.0
    assert second == pytest.approx(1.5, abs=0.5)
    assert third is None


def test_a_new_area_is_a_new_way(monkeypatch: pytest.MonkeyPatch, chart: Chart) -> None:
    other = {"id": "area-2", "center": {"x_px": 500.0, "y_px": 300.0}}
    areas = {"type": "event", "event": "areas", "critical_areas": [AREA, other]}
    manual = TWIN | {"mode": "MANUAL"}
    twins = [manual] * 3 + [manual | {"critical_area": "area-2"}] * 3
    watcher, _ = worked(monkeypatch, chart, twins, [areas])
    ends = [route.target_um[0] for route in watcher.routes if route is not None]
    assert ends == pytest.approx([9000.0, 6000.0])


def test_the_result_says_simulated_with_model_and_seed() -> None:
    desk = Desk(Seat("host", 1, "http://host", "secret"), Watcher(), AtOnce())  # type: ignore[arg-type]
    result = desk.result(7, "without_autonomy")
    assert result["simulated"] is True
    assert (result["model"], result["seed"], result["condition"]) == (MODEL_NAME, 7, "without_autonomy")
    assert result["take_over_s"] is None
    assert result["regrips"] == 3


def test_a_server_that_is_not_there_is_an_error() -> None:
    app = typer.Typer()
    app.command()(operator)
    outcome = CliRunner().invoke(app, ["--token", "secret", "--url", "http://127.0.0.1:9"])
    assert isinstance(outcome.exception, ConnectionEndedError)
    assert "web address" in str(outcome.exception)
    assert outcome.exit_code != 0

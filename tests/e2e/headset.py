"""A browser with an emulated headset (iwer), whose hands a test moves, on the headset page."""

import json
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, WebSocket

from tests.rig_process import RigProcess

IWER = Path(__file__).resolve().parents[2] / "static" / "node_modules" / "iwer" / "build" / "iwer.min.js"
BY_SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
EYES_M = (0.0, 1.6, 0.0)
REST_M = (0.15, 1.2, -0.35)
"""Where the hand rests; from here its ray meets no button."""
_MENU_M = (0.48, 1.6 - 0.38 + 0.27, -0.66 - 0.26)
_MENU_TURN = (-0.12, -0.5)
_PICTURE_M = (0.0, 1.6 - 0.38 + 0.27, -0.66 - 0.38)
_PICTURE_TURN = (-0.12, 0.0)
_PICTURE_SIZE_M = (0.56, 0.42)
_BUTTONS_M = {
    "STOP": (0.0, 0.15),
    "Auto": (-0.08, 0.06),
    "Take over": (0.08, 0.06),
    "Hold": (-0.08, -0.015),
    "Mark area": (0.08, -0.015),
    "Arm": (-0.08, -0.09),
    "Leave": (0.08, -0.165),
}
"""Places of the buttons on their panel."""
_DEVICE = """
;(() => {
  const modes = ["inline", "immersive-vr", "immersive-ar"].filter((mode) => mode !== "%s");
  const model = { ...IWER.metaQuest3, supportedSessionModes: modes };
  const device = new IWER.XRDevice(model, { stereoEnabled: false });
  device.installRuntime({ forceInstall: true });
  // It calls every position a guess.
  window.guessing = false;
  Object.defineProperty(XRPose.prototype, "emulatedPosition", { get: () => window.guessing });
  device.position.set(%s);
  device.hands.left.connected = false;
  const spin = (x, y) => {
    const [cx, sx, cy, sy] = [Math.cos(x / 2), Math.sin(x / 2), Math.cos(y / 2), Math.sin(y / 2)];
    return [sx * cy, cx * sy, -sx * sy, cx * cy];
  };
  const turned = ([x, y, z], tilt, turn) => {
    const [y1, z1] = [y * Math.cos(tilt) - z * Math.sin(tilt), y * Math.sin(tilt) + z * Math.cos(tilt)];
    return [x * Math.cos(turn) + z1 * Math.sin(turn), y1, -x * Math.sin(turn) + z1 * Math.cos(turn)];
  };
  const frames = (count) => new Promise((done) => {
    const next = () => (count-- > 0 ? requestAnimationFrame(next) : done());
    next();
  });
  window.headset = {
    device,
    input: () => (device.primaryInputMode === "hand" ? device.hands.right : device.controllers.right),
    rest([x, y, z]) {
      this.input().position.set(x, y, z);
      this.input().quaternion.set(...spin(-0.6, 0));
    },
    async pinch(closed) {
      if (device.primaryInputMode === "hand") this.input().updatePinchValue(closed ? 1 : 0);
      else this.input().updateButtonValue("trigger", closed ? 1 : 0);
      await frames(4);
    },
    async move([x, y, z], ms) {
      const at = this.input().position;
      const [from, began] = [[at.x, at.y, at.z], performance.now()];
      for (let share = 0; share < 1; ) {
        await frames(1);
        share = Math.min(1, (performance.now() - began) / ms);
        at.set(from[0] + share * x, from[1] + share * y, from[2] + share * z);
      }
    },
    async press([dx, dy], [x, y, z], [tilt, turn], rest) {
      const [ox, oy, oz] = turned([dx, dy, 0.25], tilt, turn);
      this.input().position.set(x + ox, y + oy, z + oz);
      this.input().quaternion.set(...spin(tilt, turn));
      await frames(4);
      await this.pinch(true);
      await this.pinch(false);
      this.rest(rest);
      await frames(4);
    },
  };
  device.primaryInputMode = "%s";
  headset.rest(%s);
})();
"""


class Headset:
    """A page in an emulated headset.

    Args:
        browser: Draws by software; the page is asked not to draw at all unless ``draw``.
        rig: The server.
        kind: What the operator holds, "hand" or "controller".
        lacks: A kind of session that it does not offer, such as "immersive-ar".
    """

    def __init__(
        self,
        browser: Browser,
        rig: RigProcess,
        *,
        kind: str = "hand",
        role: str = "operator",
        lacks: str = "",
        draw: bool = False,
    ) -> None:
        self._context = browser.new_context(viewport={"width": 640, "height": 360})
        device = _DEVICE % (lacks, ", ".join(map(str, EYES_M)), kind, list(REST_M))
        self._context.add_init_script(IWER.read_text() + device)
        self.page: Page = self._context.new_page()
        self.complaints: list[str] = []
        self.sent: list[dict[str, Any]] = []
        """The hand's messages."""
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("websocket", self._on_socket)
        query = f"token={rig.ready[f'{role}_token']}" + ("" if draw else "&draw=0")
        self.page.goto(f"{rig.url}/xr?{query}")

    def enter(self) -> None:
        """Enter, and wait until the hand is seen."""
        self.page.locator("#enter:enabled").click(timeout=20_000)
        self.page.wait_for_selector("html[data-xr=inside][data-hand=seen]", timeout=30_000)

    def do(self, call: str, *arguments: object) -> None:
        """Call a function of the emulated headset and wait for its end."""
        self.page.evaluate(f"headset.{call}(...{json.dumps(arguments)})")

    def press(self, button: str) -> None:
        """Point at a button of the room and pinch."""
        self.do("press", _BUTTONS_M[button], _MENU_M, _MENU_TURN, REST_M)

    def mark(self, share_x: float, share_y: float) -> None:
        """Point at a place of the microscope's picture, as shares from its upper left corner, and pinch."""
        self.press("Mark area")
        at = ((share_x - 0.5) * _PICTURE_SIZE_M[0], (0.5 - share_y) * _PICTURE_SIZE_M[1])
        self.do("press", at, _PICTURE_M, _PICTURE_TURN, REST_M)

    def see_hand(self, seen: bool) -> None:
        """Bring the right hand into view, or out of it."""
        self.page.evaluate(f"headset.input().connected = {json.dumps(seen)}")
        self.page.wait_for_selector(f"html[data-hand={'seen' if seen else 'lost'}]", timeout=10_000)

    def wait(self, ms: float) -> None:
        """Let time pass."""
        self.page.wait_for_timeout(ms)

    def rate_hz(self, first: int) -> float:
        """Return the hand's messages a second from the one with this index on."""
        t_s = [float(message["t"]) for message in self.sent[first:]]
        return (len(t_s) - 1) / (t_s[-1] - t_s[0])

    def close(self) -> None:
        """Take it off."""
        self._context.close()

    def _on_socket(self, socket: WebSocket) -> None:
        def note(payload: str | bytes) -> None:
            message = json.loads(payload)
            if message["type"] == "hand":
                self.sent.append(message)

        socket.on("framesent", note)

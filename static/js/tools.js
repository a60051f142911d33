/**
 * The tools above the picture: what a pointer on it does, the hand's scale, and how close one looks.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, setText } from "./dom.js";

/** @import { Messages } from "./messages.js" */
/** @import { Known } from "./guide.js" */
/** @import { Viewport } from "./viewport.js" */
/** @typedef {"mark" | "steer" | "pan"} Tool */
/** @typedef {"coarse" | "fine"} Scale */

const STEP = 1.5;
/** @type {Record<Tool, string>} */
const HELP = {
  mark: "Click marks an area, dragging sizes it. By keys: arrows move the cross, Enter marks.",
  steer: "Drag moves the magnet, letting go rests. By keys: arrows, C holds. By gamepad: trigger and left stick.",
  pan: "Drag moves the picture, the wheel zooms. By keys: arrows, plus, minus, 0.",
};

export class Tools {
  /** @type {Record<Tool, HTMLButtonElement>} */ #tools = {
    mark: byId("tool-mark", HTMLButtonElement),
    steer: byId("tool-steer", HTMLButtonElement),
    pan: byId("tool-pan", HTMLButtonElement),
  };
  /** @type {Record<Scale, HTMLButtonElement>} */ #scales = {
    coarse: byId("scale-coarse", HTMLButtonElement),
    fine: byId("scale-fine", HTMLButtonElement),
  };
  #out = byId("zoom-out", HTMLButtonElement);
  #in = byId("zoom-in", HTMLButtonElement);
  #fit = byId("zoom-fit", HTMLButtonElement);
  #help = byId("tool-help", HTMLElement);
  #messages;
  /** @type {Scale} */ #scale = "coarse";
  /** @type {Tool} */ tool = "mark";

  /**
   * @param {Viewport} viewport
   * @param {Messages} messages
   * @param {(tool: Tool) => void} onTool
   */
  constructor(viewport, messages, onTool) {
    this.#messages = messages;
    for (const tool of /** @type {Tool[]} */ (["mark", "steer", "pan"])) {
      this.#tools[tool].addEventListener("click", () => {
        this.choose(tool);
        onTool(tool);
      });
    }
    for (const scale of /** @type {Scale[]} */ (["coarse", "fine"])) {
      this.#scales[scale].addEventListener("click", () => this.#useScale(scale));
    }
    this.#out.addEventListener("click", () => viewport.zoom(1 / STEP));
    this.#in.addEventListener("click", () => viewport.zoom(STEP));
    this.#fit.addEventListener("click", () => viewport.fit());
    this.choose("mark");
  }

  /** @param {Tool} tool */
  choose(tool) {
    this.tool = tool;
    setText(this.#help, HELP[tool]);
    for (const [name, button] of Object.entries(this.#tools)) {
      button.setAttribute("aria-pressed", String(name === tool));
    }
  }

  /** The other scale. */
  toggleScale() {
    void this.#useScale(this.#scale === "coarse" ? "fine" : "coarse");
  }

  /** @param {Known} known @param {boolean} mine Whether this page has control. */
  show({ role, state, fresh }, mine) {
    this.#scale = state.hand.scale;
    this.#tools.steer.disabled = !fresh || role === "viewer";
    for (const [name, button] of Object.entries(this.#scales)) {
      button.setAttribute("aria-pressed", String(name === state.hand.scale));
      button.disabled = !fresh || !mine || state.clutch;
    }
  }

  /** @param {number} scale */
  showZoom(scale) {
    setText(this.#fit, `${Math.round(scale * 100)} %`);
    this.#out.disabled = scale <= 1;
  }

  /** @param {Scale} scale */
  async #useScale(scale) {
    try {
      await request("POST", "/hand", { scale });
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }
}

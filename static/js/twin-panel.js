/**
 * The card that shows the twin in three dimensions; it loads what it needs after everything else.
 * @module
 */

import { byId, setText } from "./dom.js";

/** @import { Scene3d, View } from "./scene3d.js" */
/** @import { Snapshot, State } from "./types.js" */

export class TwinPanel {
  #canvas = byId("twin-view", HTMLCanvasElement);
  #why = byId("twin-why", HTMLElement);
  /** @type {Record<View, HTMLButtonElement>} */ #views = {
    microscope: byId("twin-microscope", HTMLButtonElement),
    orbit: byId("twin-orbit", HTMLButtonElement),
  };
  /** @type {Promise<Scene3d> | null} */ #loading = null;
  /** @type {Scene3d | null} */ #scene = null;

  constructor() {
    for (const view of /** @type {View[]} */ (["microscope", "orbit"])) {
      this.#views[view].addEventListener("click", () => this.#look(view));
    }
  }

  /** Fetch the scene of this rig, areas included. @param {Snapshot} snapshot */
  async reset(snapshot) {
    try {
      this.#loading ??= import("./scene3d.js").then(({ Scene3d }) => new Scene3d(this.#canvas));
      const scene = await this.#loading;
      await scene.load(snapshot);
      this.#scene = scene;
      this.#why.hidden = true;
    } catch (error) {
      // Without WebGL the rest of the page works on.
      this.#loading = null;
      this.#canvas.dataset.state = "missing";
      this.#why.hidden = false;
      setText(this.#why, `The twin cannot be drawn here: ${error instanceof Error ? error.message : String(error)}`);
    }
  }

  /** @param {State} state */
  show(state) {
    this.#scene?.show(state);
  }

  /** @param {View} view */
  #look(view) {
    for (const [name, button] of Object.entries(this.#views)) {
      button.setAttribute("aria-pressed", String(name === view));
    }
    this.#scene?.look(view);
  }
}

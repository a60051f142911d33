/**
 * Registration: laying the vessel model onto the picture, by itself or by nudges.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, setText } from "./dom.js";
import { MISSING } from "./format.js";

/** @import { AffineRows, Pair, RegistrationAnswer, Snapshot, State } from "./types.js" */
/** @import { Messages } from "./messages.js" */

const TURN_DEG = 0.2;

export class Registration {
  #card = byId("registration", HTMLDetailsElement);
  #find = byId("registration-find", HTMLButtonElement);
  #step = byId("registration-step", HTMLInputElement);
  #overlap = byId("registration-overlap", HTMLElement);
  #residual = byId("registration-residual", HTMLElement);
  #pose = byId("registration-pose", HTMLElement);
  #why = byId("registration-why", HTMLElement);
  #nudges = [...this.#card.querySelectorAll("button")].filter((button) => button.dataset.nudge);
  #messages;
  #onChange;
  #mayEdit = false;
  #session = "";
  /** @type {AffineRows} */ #image_from_vessel = [
    [1, 0, 0],
    [0, 1, 0],
  ];
  #busy = false;
  /** The model's walls in the image, while the card is open. @type {Pair[][]} */ outline_px = [];

  /**
   * @param {Messages} messages
   * @param {() => void} onChange Called when the outline changed.
   */
  constructor(messages, onChange) {
    this.#messages = messages;
    this.#onChange = onChange;
    this.#card.addEventListener("toggle", () => this.refresh());
    this.#find.addEventListener("click", () => this.#ask({ auto: true }));
    for (const button of this.#nudges) button.addEventListener("click", () => this.#nudge(button.dataset.nudge ?? ""));
  }

  /** @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#mayEdit = snapshot.role === "operator";
    this.#session = snapshot.seat;
    this.#image_from_vessel = snapshot.calibration.image_from_vessel;
    void this.refresh();
  }

  /** Ask again: some client registered the vessel. */
  async refresh() {
    if (!this.#card.open) {
      this.#draw([]);
      return;
    }
    try {
      this.#take(/** @type {RegistrationAnswer} */ (await request("GET", "/registration")));
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }

  /** @param {State} state @param {boolean} fresh */
  show(state, fresh) {
    const has = state.lease.console === this.#session;
    const may = fresh && this.#mayEdit && has && state.mode === "DISARMED" && state.trial === null;
    for (const button of [this.#find, ...this.#nudges]) button.disabled = !may || this.#busy;
    const trial = state.trial === null ? "" : "End the trial first.";
    const need = state.mode === "DISARMED" ? trial : "Disarm first.";
    setText(this.#why, !this.#mayEdit ? "Operators register the vessel." : has ? need : "Take control first.");
  }

  /** Move the model in the picture's directions. @param {string} way x or y and the sign, or the turn's sign. */
  #nudge(way) {
    const step_um = Number.isFinite(this.#step.valueAsNumber) ? this.#step.valueAsNumber : 50;
    const signed = way.endsWith("-") ? -1 : 1;
    const [[a, b], [c, d]] = this.#image_from_vessel;
    const handed = Math.sign(a * d - b * c);
    if (way.startsWith("turn")) {
      void this.#ask({ turn_deg: signed * handed * TURN_DEG });
      return;
    }
    const [x, y] = way.startsWith("x") ? [d, -c] : [-b, a];
    const factor = (signed * handed * step_um) / Math.hypot(x, y);
    void this.#ask({ dx_um: x * factor, dy_um: y * factor });
  }

  /** @param {Record<string, boolean | number>} body */
  async #ask(body) {
    this.#busy = true;
    try {
      const answer = /** @type {RegistrationAnswer} */ (await request("POST", "/registration", body));
      this.#take(answer);
      if (answer.accepted === false) this.#messages.say(`Not registered: ${answer.reason}`, "warning");
      else this.#messages.clear();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
    this.#busy = false;
  }

  /** @param {RegistrationAnswer} answer */
  #take({ overlap, residual_um, pose, outline_px }) {
    setText(this.#overlap, overlap === null ? MISSING : `${Math.round(100 * overlap)} %`);
    setText(this.#residual, residual_um === null ? MISSING : `${residual_um.toFixed(1)} µm`);
    const { dx_um, dy_um, turn_deg } = pose;
    setText(this.#pose, `${dx_um.toFixed(0)}, ${dy_um.toFixed(0)} µm, ${turn_deg.toFixed(2)}°`);
    this.#draw(outline_px);
  }

  /** @param {Pair[][]} outline_px */
  #draw(outline_px) {
    this.outline_px = this.#card.open ? outline_px : [];
    this.#onChange();
  }
}

/**
 * Which vessel model the rig goes by: chosen here, once it lies under the microscope.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";

/** @import { Snapshot, State } from "./types.js" */
/** @import { Messages } from "./messages.js" */

/** The rig is built anew around the vessel, on a busy computer in seconds. */
const BUILD_MS = 30_000;

/** @typedef {{name: string, own: boolean, in_use: boolean}} Model */

export class VesselChoice {
  #card = byId("registration", HTMLDetailsElement);
  #select = byId("vessel-choice", HTMLSelectElement);
  #change = byId("vessel-change", HTMLButtonElement);
  #messages;
  #session = "";
  #inUse = "";
  #may = false;
  #busy = false;

  /** @param {Messages} messages */
  constructor(messages) {
    this.#messages = messages;
    this.#card.addEventListener("toggle", () => void this.#refresh());
    this.#select.addEventListener("change", () => this.#draw());
    byId("vessel-form", HTMLFormElement).addEventListener("submit", (event) => {
      event.preventDefault();
      void this.#ask();
    });
  }

  /** The server was reached, perhaps with another vessel than before. @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#session = snapshot.seat;
    this.#inUse = snapshot.vessel.name;
    this.#busy = false;
    void this.#refresh();
  }

  /** @param {State} state @param {boolean} fresh */
  show(state, fresh) {
    const has = state.lease.console === this.#session;
    this.#may = fresh && has && state.mode === "DISARMED" && state.trial === null;
    this.#draw();
  }

  async #refresh() {
    if (!this.#card.open) return;
    try {
      this.#offer(/** @type {Model[]} */ (await request("GET", "/vessels")));
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }

  /** @param {Model[]} models */
  #offer(models) {
    const names = models.map(({ name }) => name);
    if (!names.includes(this.#inUse)) names.unshift(this.#inUse);
    this.#select.replaceChildren(...names.map((name) => make("option", { value: name }, name)));
    this.#select.value = this.#inUse;
    this.#draw();
  }

  #draw() {
    const other = this.#select.value !== "" && this.#select.value !== this.#inUse;
    this.#select.disabled = !this.#may || this.#busy;
    this.#change.hidden = !other;
    this.#change.disabled = !this.#may || this.#busy;
    this.#change.dataset.next = String(other);
    setText(this.#change, `${this.#select.value} is in place`);
  }

  async #ask() {
    this.#busy = true;
    this.#draw();
    try {
      await request("POST", `/vessels/${this.#select.value}/choose`, undefined, { timeout_ms: BUILD_MS });
    } catch (error) {
      this.#messages.say(explain(error), "warning");
      this.#busy = false;
      this.#draw();
    }
  }
}

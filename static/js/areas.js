/**
 * Critical areas: marking, choosing, changing and deleting them.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, icon, make, setText } from "./dom.js";

/** @import { CriticalArea, Snapshot, VesselPoint } from "./types.js" */
/** @import { Draft } from "./gestures.js" */
/** @import { Messages } from "./messages.js" */
/** @typedef {{frame: "image" | "vessel", x: number, y: number}} Center */

const HOW_TO_MARK = "Click on the picture, or drag a circle, to mark where autonomy hands over to you.";

export class Areas {
  #list = byId("areas", HTMLUListElement);
  #empty = byId("areas-empty", HTMLElement);
  #epsilon = byId("epsilon", HTMLInputElement);
  #suggest = byId("suggest", HTMLButtonElement);
  #messages;
  #onChange;
  #mayEdit = false;
  #busy = false;
  /** @type {VesselPoint[]} */ #suggested = [];
  /** @type {CriticalArea[]} */ all = [];
  /** @type {string | null} */ chosenId = null;
  /** Whether autonomy is on its way. */ driving = false;
  /** Where Auto goes if nothing else is chosen. @type {string | null} */ #nextId = null;

  /**
   * @param {Messages} messages
   * @param {() => void} onChange Called when the areas or the choice changed.
   */
  constructor(messages, onChange) {
    this.#messages = messages;
    this.#onChange = onChange;
    this.#suggest.addEventListener("click", () => this.#markSuggested());
  }

  /** Radius of a new area, in µm. */
  get newEpsilon_um() {
    const value = this.#epsilon.valueAsNumber;
    return Number.isFinite(value) && value > 0 ? value : 500;
  }

  /** @returns {CriticalArea | null} */
  get chosen() {
    return this.all.find((area) => area.id === this.chosenId) ?? null;
  }

  /** Start from what the server has. @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#suggested = snapshot.vessel.suggested_areas;
    this.#mayEdit = snapshot.role === "operator";
    this.#epsilon.disabled = !this.#mayEdit;
    this.#replace(snapshot.critical_areas);
  }

  /**
   * Take over what the server says: some client changed the areas, or one was reached.
   * @param {CriticalArea[]} areas
   * @param {string | null} next Where Auto goes next.
   */
  update(areas, next) {
    // The choice goes on with the server, once it has arrived where it went.
    if (next !== this.#nextId && this.chosenId === this.#nextId) this.chosenId = next;
    this.#nextId = next;
    this.#replace(areas);
  }

  async #refresh() {
    await this.#try(async () => {
      this.#replace(/** @type {CriticalArea[]} */ (await request("GET", "/critical-areas")));
    });
  }

  /** Choose the goal: where Auto goes, and what a trial by hand is measured against. @param {string} id */
  choose(id) {
    this.chosenId = id;
    this.#render();
    this.#onChange();
    // Autonomy on its way keeps its goal; it is told the choice when it is asked for the next time.
    if (this.#mayEdit && !this.driving) void this.#try(() => this.#tellChoice(id));
  }

  /** @param {string} id */
  async #tellChoice(id) {
    await request("POST", `/critical-areas/${encodeURIComponent(id)}/choose`);
  }

  /** Mark, move or size an area as it was drawn on the picture. @param {Draft} draft */
  async draw({ id, image_px: [x, y], epsilon_um }) {
    const center = /** @type {const} */ ({ frame: "image", x, y });
    const area = this.all.find((known) => known.id === id);
    if (area) await this.#change(area, { center, epsilon_um });
    else await this.#add(center, epsilon_um);
  }

  /** @param {Center} center @param {number} [epsilon_um] */
  async #add(center, epsilon_um = this.newEpsilon_um) {
    if (this.#busy) return;
    this.#busy = true;
    await this.#try(async () => {
      const body = { center, epsilon_um, label: "" };
      const area = /** @type {CriticalArea} */ (await request("POST", "/critical-areas", body));
      this.chosenId = area.id;
      this.#messages.clear();
      if (!this.driving) await this.#tellChoice(area.id);
      await this.#refresh();
    });
    this.#busy = false;
  }

  async #markSuggested() {
    const next = this.#unmarkedSuggestions()[0];
    if (next) await this.#add({ frame: "vessel", x: next.x_px, y: next.y_px });
  }

  #unmarkedSuggestions() {
    return this.#suggested.filter(
      ({ x_px, y_px }) =>
        !this.all.some(({ center }) => Math.hypot(center.x_px - x_px, center.y_px - y_px) < 1),
    );
  }

  /** @param {CriticalArea} area @param {{epsilon_um?: number, label?: string, center?: Center}} change */
  async #change(area, change) {
    await this.#try(async () => {
      const here = { frame: "vessel", x: area.center.x_px, y: area.center.y_px };
      const { epsilon_um, label, center } = { ...area, center: here, ...change };
      await request("PUT", `/critical-areas/${encodeURIComponent(area.id)}`, { center, epsilon_um, label });
      this.#messages.clear();
    });
    await this.#refresh();
  }

  /** @param {CriticalArea} area */
  async #delete(area) {
    await this.#try(async () => {
      await request("DELETE", `/critical-areas/${encodeURIComponent(area.id)}`);
      this.#messages.clear();
    });
    await this.#refresh();
  }

  /** Let an area be visited before another one. @param {string} id @param {number} to Its new place. */
  async #move(id, to) {
    const order = this.all.map((area) => area.id).filter((other) => other !== id);
    order.splice(to, 0, id);
    await this.#try(async () => {
      await request("PUT", "/critical-areas", { order });
      this.#messages.clear();
    });
    await this.#refresh();
  }

  /** @param {() => Promise<void>} action */
  async #try(action) {
    try {
      await action();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }

  /** @param {CriticalArea[]} areas */
  #replace(areas) {
    this.all = areas;
    if (!this.chosen) {
      this.chosenId = (areas.find((area) => area.active) ?? areas[0])?.id ?? null;
    }
    this.#render();
    this.#onChange();
  }

  #render() {
    this.#empty.hidden = this.all.length > 0;
    setText(this.#empty, this.#mayEdit ? HOW_TO_MARK : "None is marked.");
    const left = this.#unmarkedSuggestions().length;
    this.#suggest.hidden = !this.#mayEdit || left === 0;
    setText(this.#suggest, `Mark suggested (${left})`);
    const focused = document.activeElement instanceof HTMLElement ? document.activeElement.dataset.key : undefined;
    this.#list.replaceChildren(...this.all.map((area, place) => this.#row(area, place)));
    if (focused) this.#list.querySelector(/** @type {"input"} */ (`[data-key="${CSS.escape(focused)}"]`))?.focus();
  }

  /** @param {CriticalArea} area @param {number} place @returns {HTMLLIElement} */
  #row(area, place) {
    const name = area.label || area.id;
    const choice = make("input", { type: "radio", name: "area", value: area.id, "aria-label": `Choose ${name}` });
    choice.checked = area.id === this.chosenId;
    choice.addEventListener("change", () => this.choose(area.id));

    const label = make("input", { type: "text", maxlength: "40", "aria-label": `Label of ${area.id}` });
    label.className = "quiet";
    label.value = name;
    label.disabled = !this.#mayEdit;
    label.addEventListener("change", () => this.#change(area, { label: label.value.trim() }));

    const epsilon = make("input", { type: "number", min: "50", max: "3000", step: "50" });
    epsilon.setAttribute("aria-label", `Radius ε of ${name} in µm`);
    epsilon.className = "quiet number";
    epsilon.valueAsNumber = area.epsilon_um;
    epsilon.disabled = !this.#mayEdit;
    epsilon.addEventListener("change", () => this.#change(area, { epsilon_um: epsilon.valueAsNumber }));

    const remove = make("button", { type: "button", class: "plain", "aria-label": `Delete ${name}` });
    remove.dataset.testid = `area-delete-${area.id}`;
    remove.append(icon("i-delete"));
    remove.disabled = !this.#mayEdit;
    remove.addEventListener("click", () => this.#delete(area));

    const sooner = make("button", { type: "button", class: "plain", "aria-label": `Visit ${name} sooner` }, "↑");
    sooner.disabled = !this.#mayEdit || place === 0;
    sooner.hidden = this.all.length < 2;
    sooner.addEventListener("click", () => this.#move(area.id, place - 1));

    for (const [part, element] of Object.entries({ choice, label, epsilon, sooner, remove })) {
      element.dataset.key = `${area.id} ${part}`;
    }
    const row = make("li", { "data-testid": `area-${area.id}`, "data-active": String(area.active) });
    const radius = make("span", { class: "unit" }, epsilon, "µm");
    const where = make("small", { class: "where" }, this.#where(area));
    const handle = make("label", { class: "choice" }, choice, icon("i-area"));
    row.append(handle, label, where, radius, sooner, remove);
    this.#letDrag(handle, row, area.id, place);
    return row;
  }

  /** @param {CriticalArea} area */
  #where({ id, visited }) {
    if (id === this.#nextId && this.all.length > 1) return "next";
    return visited ? "visited" : "";
  }

  /**
   * Rows are dragged into another order; the buttons do the same.
   * @param {HTMLElement} handle
   * @param {HTMLLIElement} row
   * @param {string} id
   * @param {number} place
   */
  #letDrag(handle, row, id, place) {
    handle.draggable = this.#mayEdit && this.all.length > 1;
    handle.addEventListener("dragstart", (event) => event.dataTransfer?.setData("text/plain", id));
    row.addEventListener("dragover", (event) => event.preventDefault());
    row.addEventListener("drop", (event) => {
      event.preventDefault();
      const dragged = event.dataTransfer?.getData("text/plain") ?? "";
      if (this.all.some((area) => area.id === dragged)) void this.#move(dragged, place);
    });
  }
}

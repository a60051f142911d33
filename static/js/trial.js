/**
 * Trials: start, end, result.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { clock, MISSING } from "./format.js";

/** @import { Snapshot, State, Trial, TrialResult } from "./types.js" */
/** @import { Messages } from "./messages.js" */

/** On a busy computer a long trial's report takes its time. */
const REPORT_MS = 120_000;

export class Trials {
  #form = byId("trial-form", HTMLFormElement);
  #running = byId("trial-running", HTMLElement);
  #name = byId("trial-name", HTMLElement);
  #elapsed = byId("trial-elapsed", HTMLElement);
  #who = byId("participant-label", HTMLElement);
  #start = byId("trial-start", HTMLButtonElement);
  #end = byId("trial-end", HTMLButtonElement);
  #result = byId("trial-result", HTMLElement);
  #rows = byId("trial-metrics", HTMLElement);
  #resultName = byId("trial-result-name", HTMLElement);
  #folder = byId("trial-folder", HTMLElement);
  #resultSimulated = byId("trial-result-simulated", HTMLElement);
  #tlx = byId("trial-tlx", HTMLAnchorElement);
  #messages;
  #simulatedRig = false;
  #mayEdit = false;
  /** @type {string | null} */ #id = null;
  #since_s = 0;

  /** @param {Messages} messages */
  constructor(messages) {
    this.#messages = messages;
    this.#form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.#begin();
    });
    this.#form.addEventListener("change", () => this.#showWho());
    this.#end.addEventListener("click", () => this.#finish());
    byId("trial-result-close", HTMLButtonElement).addEventListener("click", () => {
      this.#result.hidden = true;
    });
  }

  /** @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#simulatedRig = snapshot.rig.simulated;
    this.#mayEdit = snapshot.role === "operator";
  }

  /** @param {State} state @param {number} now_s The page's clock. @param {boolean} fresh */
  show(state, now_s, fresh) {
    if (state.trial !== this.#id) {
      this.#id = state.trial;
      this.#since_s = now_s;
      if (state.trial) this.#result.hidden = true;
    }
    this.#form.hidden = this.#id !== null || !this.#result.hidden;
    this.#running.hidden = this.#id === null;
    this.#start.disabled = !fresh || !this.#mayEdit;
    this.#end.disabled = !fresh || !this.#mayEdit;
    if (this.#id === null) return;
    setText(this.#name, this.#id);
    setText(this.#elapsed, clock(now_s - this.#since_s));
  }

  /** A simulated operator is never called a participant. */
  #showWho() {
    const simulated = new FormData(this.#form).get("operator_kind") === "simulated";
    setText(this.#who, simulated ? "Simulated operator" : "Participant");
  }

  async #begin() {
    const data = new FormData(this.#form);
    const body = {
      participant: String(data.get("participant") ?? "").trim(),
      condition: data.get("condition"),
      operator_kind: data.get("operator_kind"),
      notes: String(data.get("notes") ?? "").trim(),
    };
    try {
      const trial = /** @type {Trial} */ (await request("POST", "/trials", body));
      this.#messages.say(`Trial ${trial.id} runs`, "info");
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }

  async #finish() {
    const id = this.#id;
    if (id === null) return;
    try {
      this.#messages.say("The trial ends; its figures are being computed", "info");
      const path = `/trials/${encodeURIComponent(id)}/end`;
      const result = await request("POST", path, undefined, { timeout_ms: REPORT_MS });
      this.#showResult(id, /** @type {TrialResult} */ (result));
      this.#messages.clear();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }

  /** @param {string} id @param {TrialResult} result */
  #showResult(id, result) {
    setText(this.#resultName, id);
    const simulated = this.#simulatedRig || result.simulated === true || result.operator_kind === "simulated";
    this.#resultSimulated.hidden = !simulated;
    const query = `?trial=${encodeURIComponent(id)}`;
    // Only people have a workload to tell of.
    this.#tlx.hidden = result.operator_kind === "simulated";
    this.#tlx.href = `/tlx.html${query}`;
    byId("trial-results", HTMLAnchorElement).href = `/results.html${query}`;
    setText(this.#folder, typeof result.folder === "string" ? `Recorded in ${result.folder}` : "");
    this.#rows.replaceChildren(...describe(result).map(({ name, hint, value }) =>
      make("tr", {}, make("th", { scope: "row" }, name, make("small", {}, hint)), make("td", {}, value)),
    ));
    this.#result.hidden = false;
  }
}

/** Figures in the study's order: keys of which the first present one counts, name, unit, digits. */
const FIGURES = /** @type {const} */ ([
  [["average_speed_um_per_s"], "Average speed", "µm/s", 0],
  [["completion_s"], "Time of completion", "s", 2],
  [["straightness"], "Straightness G", "log₁₀(1/µm)", 2],
  [["smoothness"], "Smoothness S", "", 2],
  [["contacts", "collisions"], "Wall contacts", "", 0],
  [["min_clearance_um"], "Smallest gap to the wall", "µm", 0],
  [["final_distance_um"], "Distance at the end", "µm", 0],
]);

/**
 * Turn a result into lines for a person; what the result lacks is left out.
 * @param {TrialResult} result
 * @returns {{name: string, hint: string, value: string}[]}
 */
function describe(result) {
  const values = { ...result, ...asRecord(result.metrics) };
  const direction = asRecord(result.direction);
  const lines = [];
  for (const [keys, name, unit, digits] of FIGURES) {
    const key = keys.find((candidate) => candidate in values);
    if (key === undefined) continue;
    const raw = asRecord(values[key]).value ?? values[key];
    const value = typeof raw === "number" ? `${raw.toFixed(digits)} ${unit}`.trim() : MISSING;
    lines.push({ name, hint: String(direction[key] ?? ""), value });
  }
  return lines;
}

/** @param {unknown} value @returns {Record<string, unknown>} */
function asRecord(value) {
  return value !== null && typeof value === "object" ? { ...value } : {};
}

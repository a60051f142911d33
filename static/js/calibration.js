/**
 * The guided calibration: says what is to be done next, shows what was measured, and has it used.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";

/** @import { CalibrationFigure, CalibrationState, Snapshot, State } from "./types.js" */
/** @import { Messages } from "./messages.js" */

const REFRESH_MS = 500;
const SVG = "http://www.w3.org/2000/svg";
const ROW = 18;
const LEFT = 112;
const RIGHT = 248;
/** @type {Record<string, string>} */
const LABEL = { idle: "Begin", waiting: "Prepared: go on", moving: "Moving…", stopping: "Stopping…", done: "Use this calibration" };

export class Calibration {
  #card = byId("calibration", HTMLDetailsElement);
  #stages = byId("calibration-stages", HTMLOListElement);
  #text = byId("calibration-text", HTMLElement);
  #refusal = byId("calibration-refusal", HTMLElement);
  #progress = byId("calibration-progress", HTMLProgressElement);
  #plan = byId("calibration-plan", HTMLElement);
  #square = byId("calibration-square", HTMLInputElement);
  #water = byId("calibration-water", HTMLInputElement);
  #next = byId("calibration-next", HTMLButtonElement);
  #cancel = byId("calibration-cancel", HTMLButtonElement);
  #plot = byId("calibration-plot", HTMLElement);
  #kept = byId("calibration-kept", HTMLElement);
  #why = byId("calibration-why", HTMLElement);
  #messages;
  #mayEdit = false;
  #session = "";
  #busy = false;
  #drawn = "";
  /** @type {CalibrationState | null} */ #is = null;

  /** @param {Messages} messages */
  constructor(messages) {
    this.#messages = messages;
    this.#card.addEventListener("toggle", () => void this.#refresh(true));
    this.#next.addEventListener("click", () => void this.#goOn());
    this.#cancel.addEventListener("click", () => void this.#ask("cancel"));
    setInterval(() => void this.#refresh(false), REFRESH_MS);
  }

  /** @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#mayEdit = snapshot.role === "operator";
    this.#session = snapshot.seat;
    void this.#refresh(true);
  }

  /** @param {State} state @param {boolean} fresh */
  show(state, fresh) {
    const has = state.lease.console === this.#session;
    const phase = this.#is?.phase ?? "idle";
    const rests = phase !== "moving" && phase !== "stopping";
    const may = fresh && this.#mayEdit && has && state.mode === "DISARMED" && state.trial === null;
    const used = this.#is?.file !== null && this.#is !== null;
    this.#next.disabled = !may || this.#busy || !rests;
    setText(this.#next, used ? "Calibrate again" : (LABEL[phase] ?? ""));
    this.#cancel.hidden = phase === "idle" || used;
    this.#cancel.disabled = !this.#mayEdit || this.#busy;
    const disarm = state.mode === "STOP" || state.mode === "FAULT" ? "Reset first." : "Disarm first.";
    const trial = state.trial === null ? "" : "End the trial first.";
    const need = state.mode === "DISARMED" ? trial : disarm;
    const why = !this.#mayEdit ? "Operators calibrate." : has ? need : "Take control first.";
    setText(this.#why, rests ? why : "STOP or the space bar ends the motion; keep this page open.");
  }

  /** @param {boolean} always */
  async #refresh(always) {
    const moves = this.#is?.phase === "moving" || this.#is?.phase === "stopping";
    if (!this.#card.open || this.#busy || !(always || moves)) return;
    try {
      this.#take(/** @type {CalibrationState} */ (await request("GET", "/calibration")));
    } catch (error) {
      if (always) this.#messages.say(explain(error), "warning");
    }
  }

  async #goOn() {
    const phase = this.#is?.phase ?? "idle";
    if (phase === "waiting") await this.#ask("next");
    else if (phase === "done" && this.#is?.file === null) await this.#ask("use");
    else {
      const [square_um, water_depth_um] = [this.#square.valueAsNumber, this.#water.valueAsNumber];
      if (!Number.isFinite(square_um) || !Number.isFinite(water_depth_um)) {
        this.#messages.say("Give the square's side and the depth of water in µm", "warning");
        return;
      }
      await this.#ask("begin", { square_um, water_depth_um });
    }
  }

  /** @param {string} what @param {Record<string, number>} [body] */
  async #ask(what, body) {
    this.#busy = true;
    try {
      this.#take(/** @type {CalibrationState} */ (await request("POST", `/calibration/${what}`, body)));
      this.#messages.clear();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
    this.#busy = false;
  }

  /** @param {CalibrationState} is */
  #take(is) {
    const first = this.#is === null;
    this.#is = is;
    if (first) {
      this.#square.value = String(is.plan.square_um);
      this.#water.value = String(is.plan.water_depth_um);
    }
    this.#plan.hidden = is.phase !== "idle" && is.file === null;
    const doing = is.phase === "done" ? "All is measured. Look at the residuals, put the vessel back, then use it." : is.text;
    setText(this.#text, is.file === null ? doing : "This calibration is in use. Register the vessel next.");
    setText(this.#refusal, is.refusal);
    this.#refusal.hidden = is.refusal === "";
    this.#progress.hidden = is.phase !== "moving";
    this.#progress.value = is.share;
    setText(this.#kept, is.setting === null ? "" : `To keep it over a restart, set ${is.setting}`);
    const now = JSON.stringify([is.stages, is.stage]);
    if (now === this.#drawn) return;
    this.#drawn = now;
    this.#stages.replaceChildren(
      ...is.stages.map(({ stage, done }) =>
        make("li", { "data-done": String(done), ...(stage === is.stage ? { "aria-current": "step" } : {}) }, stage),
      ),
    );
    const figures = is.stages.flatMap(({ stage, figures }) =>
      figures.map((figure) => ({ ...figure, name: `${stage}: ${figure.name}` })),
    );
    this.#plot.replaceChildren(...(figures.length > 0 ? [plot(figures, is.simulated)] : []));
  }
}

/**
 * A bar for each figure that has a bound, at half the width when it reaches it; the others as numbers.
 * @param {CalibrationFigure[]} figures @param {boolean} simulated
 */
function plot(figures, simulated) {
  const svg = element("svg", { viewBox: `0 0 320 ${ROW * (figures.length + 1)}`, role: "img" });
  const title = simulated ? "Residuals in µm (simulated); the line is the bound" : "Residuals in µm; the line is the bound";
  svg.setAttribute("aria-label", title);
  svg.append(element("text", { x: "0", y: "12" }, title));
  figures.forEach(({ name, value_um, bound_um }, row) => {
    const y = ROW * (row + 1);
    svg.append(element("text", { x: "0", y: String(y + 12) }, name));
    if (bound_um !== null) {
      const half = (RIGHT - LEFT) / 2;
      const width = Math.min((value_um / bound_um) * half, 2 * half);
      svg.append(element("rect", { class: "bar", x: String(LEFT), y: String(y + 4), width: width.toFixed(1), height: "8" }));
      const at = String(LEFT + half);
      svg.append(element("line", { class: "bound", x1: at, x2: at, y1: String(y + 1), y2: String(y + 15) }));
    }
    svg.append(element("text", { x: String(RIGHT + 8), y: String(y + 12) }, value_um.toFixed(1)));
  });
  return svg;
}

/** @param {string} name @param {Record<string, string>} attributes @param {string} [text] */
function element(name, attributes, text = "") {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.textContent = text;
  return node;
}

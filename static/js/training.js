/**
 * The training wizard: a picture of a vessel, what was found in it, a policy, and its use.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { facts, percent, STAGES } from "./training-words.js";

/** @import { Snapshot, State } from "./types.js" */
/** @import { TrainingState } from "./training-types.js" */
/** @import { Messages } from "./messages.js" */

const REFRESH_MS = 1000;
const UPLOAD_MS = 70_000;

export class Training {
  #card = byId("training", HTMLDetailsElement);
  #form = byId("training-form", HTMLFormElement);
  #model = byId("training-model", HTMLSelectElement);
  #file = byId("training-file", HTMLInputElement);
  #name = byId("training-name", HTMLInputElement);
  #scale = byId("training-scale", HTMLInputElement);
  #find = byId("training-find", HTMLButtonElement);
  #found = byId("training-found", HTMLElement);
  #preview = byId("training-preview", HTMLImageElement);
  #facts = byId("training-facts", HTMLElement);
  #notes = byId("training-notes", HTMLElement);
  #preset = byId("training-preset", HTMLSelectElement);
  #seed = byId("training-seed", HTMLInputElement);
  #begin = byId("training-begin", HTMLButtonElement);
  #cancel = byId("training-cancel", HTMLButtonElement);
  #text = byId("training-text", HTMLElement);
  #bar = byId("training-progress", HTMLProgressElement);
  #refusal = byId("training-refusal", HTMLElement);
  #result = byId("training-result", HTMLElement);
  #use = byId("training-use", HTMLButtonElement);
  #why = byId("training-why", HTMLElement);
  #messages;
  #onUsed;
  #isOperator = false;
  #busy = false;
  #fresh = false;
  #resting = false;
  /** @type {TrainingState | null} */ #is = null;

  /**
   * @param {Messages} messages
   * @param {() => void} onUsed Called when another policy drives.
   */
  constructor(messages, onUsed) {
    this.#messages = messages;
    this.#onUsed = onUsed;
    this.#card.addEventListener("toggle", () => void this.#refresh());
    this.#form.addEventListener("change", () => this.#draw());
    this.#form.addEventListener("submit", (event) => event.preventDefault());
    this.#find.addEventListener("click", () => void this.#import());
    this.#begin.addEventListener("click", () => {
      const [model, preset, seed] = [this.#model.value, this.#preset.value, this.#seed.valueAsNumber];
      if (Number.isInteger(seed)) void this.#ask("begin", { model, preset, seed });
      else this.#messages.say("Give the seed: a whole number, 0 for example", "warning");
    });
    this.#cancel.addEventListener("click", () => void this.#ask("cancel"));
    this.#use.addEventListener("click", () => void this.#ask("use").then(this.#onUsed));
    setInterval(() => {
      if (this.#card.open && !this.#busy) void this.#refresh();
    }, REFRESH_MS);
  }

  /** @param {Snapshot} snapshot */
  async reset(snapshot) {
    this.#isOperator = snapshot.role === "operator";
    await this.#refresh();
    // Who loads the page again while something runs finds it open where it stands.
    if (this.#running) this.#card.open = true;
    this.#draw();
  }

  /** @param {State} state @param {boolean} fresh */
  show(state, fresh) {
    const resting = state.trial === null && !["MANUAL", "AUTO", "HOLD"].includes(state.mode);
    if (resting === this.#resting && fresh === this.#fresh) return;
    this.#resting = resting;
    this.#fresh = fresh;
    void this.#refresh();
  }

  get #running() {
    return this.#is?.phase === "importing" || this.#is?.phase === "training";
  }

  async #refresh() {
    if (!this.#isOperator || (!this.#card.open && this.#is !== null)) return this.#draw();
    try {
      this.#take(/** @type {TrainingState} */ (await request("GET", "/training")));
    } catch {
      // The banner says that the server is away; the next refresh finds it again.
    }
  }

  async #import() {
    const [source, name, um_per_px] = [this.#source, this.#name.value.trim(), this.#scale.valueAsNumber];
    if (name === "") return this.#messages.say("Name the vessel model", "warning");
    if (source === "live") return this.#ask("live", { name });
    const file = this.#file.files?.[0];
    if (!file) return this.#messages.say("Choose a picture of the vessel", "warning");
    if (!(um_per_px > 0)) return this.#messages.say("Give the size of one pixel of the picture in µm", "warning");
    const query = new URLSearchParams({ name, um_per_px: String(um_per_px) });
    return this.#ask(`picture?${query}`, file);
  }

  get #source() {
    return String(new FormData(this.#form).get("source"));
  }

  /** @param {string} what @param {unknown} [body] */
  async #ask(what, body) {
    this.#busy = true;
    this.#draw();
    try {
      const answer = await request("POST", `/training/${what}`, body, { timeout_ms: UPLOAD_MS });
      this.#messages.clear();
      this.#take(/** @type {TrainingState} */ (answer));
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
    this.#busy = false;
    this.#draw();
  }

  /** @param {TrainingState} is */
  #take(is) {
    const before = this.#is;
    this.#is = is;
    const names = is.models.map(({ name }) => name);
    if (names.join() !== before?.models.map(({ name }) => name).join()) this.#offer(is);
    if (is.phase === "imported" && before?.phase !== "imported") this.#showFound(is);
    this.#draw();
  }

  /** @param {TrainingState} is */
  #offer(is) {
    const chosen = this.#model.value || is.models.find(({ in_use }) => in_use)?.name || "";
    const options = is.models.map(({ name, in_use }) =>
      make("option", { value: name }, in_use ? `${name} (in use)` : name),
    );
    this.#model.replaceChildren(...options);
    this.#model.value = chosen;
    if (this.#preset.options.length > 0) return;
    this.#preset.replaceChildren(...is.presets.map((name) => make("option", { value: name }, name)));
  }

  /** @param {TrainingState} is */
  #showFound({ model, report }) {
    if (!model || !report) return;
    this.#model.value = model;
    // The same name may hold another picture now.
    this.#preview.src = `/api/v1/training/models/${model}/preview.png?${Date.now()}`;
    this.#facts.replaceChildren(
      ...facts(report).map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))),
    );
    this.#notes.replaceChildren(...report.notes.map((note) => make("li", {}, note)));
  }

  #draw() {
    const is = this.#is;
    const source = this.#source;
    const why = this.#isOperator ? (is?.objection ?? "") : "Operators train policies.";
    const may = this.#isOperator && this.#fresh && !this.#busy && !this.#running && why === "";
    for (const part of this.#form.querySelectorAll("[data-source]")) {
      if (part instanceof HTMLElement) part.hidden = !part.dataset.source?.split(" ").includes(source);
    }
    for (const control of [this.#find, this.#begin, this.#use]) control.disabled = !may;
    this.#find.dataset.next = String(source !== "model" && (is?.phase === "idle" || is?.phase === "failed"));
    this.#begin.dataset.next = String(is?.phase === "imported");
    this.#cancel.hidden = !this.#running;
    this.#cancel.disabled = this.#busy;
    this.#found.hidden = is?.report === undefined || is.model !== this.#model.value;
    setText(this.#why, why);
    setText(this.#refusal, is?.refusal ?? "");
    this.#refusal.hidden = !is?.refusal;
    this.#drawProgress();
    this.#result.hidden = is?.evaluation === undefined;
    this.#use.hidden = is?.evaluation === undefined || is.used !== "";
    if (is?.evaluation) setText(this.#result, percent(is.evaluation));
  }

  #drawProgress() {
    const is = this.#is;
    this.#bar.hidden = !this.#running;
    if (is?.phase === "importing") {
      this.#bar.removeAttribute("value");
      setText(this.#text, `Looking for the vessel in the picture of ${is.model}…`);
    } else if (is?.phase === "training" && is.progress) {
      const { stage, share, success, left_s } = is.progress;
      if (share > 0) this.#bar.value = share;
      else this.#bar.removeAttribute("value");
      const rate = success === null ? "" : `, success ${Math.round(100 * success)} % (simulated)`;
      const left = left_s === null ? "" : `, about ${left_s < 90 ? `${left_s} s` : `${Math.round(left_s / 60)} min`} left`;
      setText(this.#text, `${is.model}: ${STAGES[stage] ?? stage}${rate}${left}`);
    } else setText(this.#text, is?.used ?? "");
  }
}

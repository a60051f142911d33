/**
 * Leads the experimenter through a study: whose turn it is, what to do now, how far all is. The server knows all of it.
 * @module
 */

import { ApiError, explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { clock } from "./format.js";
import { button, cells, whereabouts } from "./study-guide.js";

/** @import { Snapshot } from "./types.js" */
/** @import { Messages } from "./messages.js" */
/** @import { Study } from "./study-types.js" */

const REFRESH_MS = 2000;
/** On a busy computer a long trial's report takes its time. */
const REPORT_MS = 120_000;
const SURE_MS = 4000;

export class StudyPanel {
  #panel = byId("study", HTMLElement);
  #freeTrials = byId("trial-card", HTMLElement);
  #code = byId("study-code", HTMLElement);
  #number = byId("study-number", HTMLElement);
  #where = byId("study-where", HTMLElement);
  #say = byId("study-say", HTMLElement);
  #trouble = byId("study-trouble", HTMLElement);
  #left = byId("study-left", HTMLElement);
  #go = byId("study-go", HTMLButtonElement);
  #ask = byId("study-ask", HTMLAnchorElement);
  #interrupt = byId("study-interrupt", HTMLButtonElement);
  #steps = byId("study-steps", HTMLElement);
  #count = byId("study-count", HTMLElement);
  #progress = byId("study-progress", HTMLProgressElement);
  #participants = byId("study-participants", HTMLElement);
  #messages;
  /** @type {Study | null} */ #study = null;
  #mayLead = false;
  #busy = false;
  #reached = false;
  #until_s = 0;
  #sure_ms = -Infinity;
  /** What is drawn of the plan, to leave it alone while nothing changes. */
  #drawn = "";

  /** @param {Messages} messages */
  constructor(messages) {
    this.#messages = messages;
    this.#go.addEventListener("click", () => void this.#press());
    this.#interrupt.addEventListener("click", () => void this.#giveUp());
    this.#ask.addEventListener("click", () => {
      // The page opens by itself; a questionnaire that is opened is begun.
      if (this.#study && !this.#study.doing) void this.#move("next");
    });
    setInterval(() => {
      if (!document.hidden) this.onNews();
    }, REFRESH_MS);
  }

  /** The server was reached, perhaps another one than before. @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#mayLead = snapshot.role === "operator";
    this.#reached = false;
    void this.#refresh();
  }

  /** A mark of the running trial. @param {string} mark */
  onMark(mark) {
    this.#reached = mark === "reached" || (mark !== "start" && this.#reached);
    this.onNews();
  }

  /** Something changed that a step may depend on. */
  onNews() {
    if (this.#study) void this.#refresh();
  }

  /** Ask where the study stands; a server without one is asked once. */
  async #refresh() {
    if (this.#busy) return;
    try {
      this.#take(/** @type {Study} */ (await request("GET", "/study")));
    } catch (error) {
      if (error instanceof ApiError && error.status === 404) this.#take(null);
    }
  }

  /** @param {number} now_s The page's clock. @param {boolean} fresh */
  show(now_s, fresh) {
    const study = this.#study;
    if (!study) return;
    const trains = study.doing && study.step?.kind === "training";
    const left_s = trains ? Math.max(0, this.#until_s - now_s) : null;
    this.#left.hidden = left_s === null;
    if (left_s !== null) setText(this.#left, clock(Math.ceil(left_s)));
    const may = fresh && this.#mayLead && !this.#busy;
    const go = button(study, left_s, this.#reached);
    this.#go.hidden = go === null;
    this.#go.disabled = !may || !go?.may;
    this.#go.dataset.next = String(go?.due === true);
    if (go) setText(this.#go, go.label);
    this.#interrupt.hidden = !study.doing;
    this.#interrupt.disabled = !may;
    const sure = performance.now() - this.#sure_ms < SURE_MS;
    this.#interrupt.dataset.sure = String(sure);
    setText(this.#interrupt, sure ? "Do it again later?" : "Give up");
  }

  async #press() {
    const study = this.#study;
    const go = study && button(study, 0, true);
    if (!study || !go) return;
    if (go.move === "finish" && study.step?.kind === "trial") {
      this.#messages.say("The trial ends; its figures are being computed", "info");
    }
    if (go.move === "vessel") await this.#changeVessel();
    else await this.#move(go.move);
  }

  /** All links break; the study is asked for again when they are back. */
  async #changeVessel() {
    this.#busy = true;
    try {
      await request("POST", "/study/vessel", undefined, { timeout_ms: REPORT_MS });
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
    this.#busy = false;
  }

  /** A second press within a moment means it. */
  async #giveUp() {
    const sure = performance.now() - this.#sure_ms < SURE_MS;
    this.#sure_ms = sure ? -Infinity : performance.now();
    if (sure) await this.#move("interrupt");
  }

  /** @param {"next" | "finish" | "interrupt"} move */
  async #move(move) {
    if (this.#busy) return;
    this.#busy = true;
    try {
      const study = await request("POST", `/study/${move}`, undefined, { timeout_ms: REPORT_MS });
      this.#take(/** @type {Study} */ (study));
      this.#messages.clear();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    } finally {
      this.#busy = false;
    }
    if (this.#go.hidden && !this.#ask.hidden) this.#ask.focus();
  }

  /** @param {Study | null} study */
  #take(study) {
    this.#study = study;
    this.#panel.hidden = study === null;
    this.#freeTrials.hidden = study !== null;
    if (!study) return;
    const now_s = performance.now() / 1000;
    this.#until_s = now_s + (study.left_s ?? 0);
    const { step, own, participants } = study;
    const code = step?.code ?? "";
    setText(this.#code, code);
    const place = participants.findIndex((each) => each.code === code) + 1;
    setText(this.#number, step ? `${place} of ${participants.length}` : "");
    const words = step ? whereabouts(step, own) : [];
    if (study.again) words.push("again: it was interrupted");
    if (words.join() !== this.#where.dataset.words) {
      this.#where.dataset.words = words.join();
      this.#where.replaceChildren(...words.map((word, i) => make(i === 1 ? "b" : "span", {}, word)));
    }
    setText(this.#say, study.say);
    this.#trouble.hidden = study.refusal === "";
    if (this.#trouble.lastElementChild) setText(this.#trouble.lastElementChild, study.refusal);
    this.#ask.hidden = step?.kind !== "questionnaire" || !study.trial || !this.#mayLead;
    if (study.trial) this.#ask.href = `/tlx?trial=${encodeURIComponent(study.trial)}`;
    this.#ask.dataset.next = String(study.answered !== true);
    setText(this.#ask, study.answered ? "Answered ✓" : study.doing ? "Open again" : "Open questionnaire");
    this.#drawPlan(study);
    this.show(now_s, true);
  }

  /** @param {Study} study */
  #drawPlan(study) {
    const { step, own, participants } = study;
    const now = JSON.stringify([step?.id, own, participants]);
    if (now === this.#drawn) return;
    this.#drawn = now;
    const blocks = [...new Set(own.map((each) => each.block))];
    this.#steps.replaceChildren(
      ...blocks.map((block) => {
        const steps = own.filter((each) => each.block === block);
        const title = `${block} · ${steps[0]?.condition.replace("_", " ")}`;
        const list = make("ol", { class: "cells", "aria-label": `Block ${title}` }, ...cells(steps, step?.id ?? null).map(cell));
        return make("div", {}, make("p", {}, title), list);
      }),
    );
    setText(this.#count, `${study.done} of ${study.steps} steps`);
    this.#progress.max = study.steps;
    this.#progress.value = study.done;
    this.#participants.replaceChildren(
      ...participants.map((each) => {
        const bar = make("progress", { max: String(each.steps), value: String(each.done), "aria-label": `${each.code}: ${each.done} of ${each.steps} steps` });
        const often = each.interrupted > 0 ? `, ${each.interrupted} interrupted` : "";
        const row = make("tr", {}, make("th", { scope: "row" }, each.code), make("td", {}, bar), make("td", {}, `${each.done} of ${each.steps}${often}`));
        if (each.code === step?.code) row.setAttribute("aria-current", "true");
        return row;
      }),
    );
  }
}

/** @param {import("./study-guide.js").Cell} is */
function cell({ sign, title, status, begins }) {
  const item = make("li", { title, "data-status": status, "data-model-begins": String(begins) });
  item.append(make("span", { "aria-hidden": "true" }, sign), make("span", { class: "unseen" }, title));
  if (status === "now") item.setAttribute("aria-current", "step");
  return item;
}

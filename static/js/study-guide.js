/**
 * What the experimenter does next in a study. Plain functions of what the server says.
 * @module
 */

/** @import { OwnStep, Step, Study } from "./study-types.js" */

/** @typedef {"next" | "finish" | "vessel"} Move */

/**
 * The one button: what it says, what it asks for, and whether it is what is to be done now.
 * @typedef {{label: string, move: Move, may: boolean, due: boolean}} Button
 */

const NAMES = { training: "training", trial: "trial", questionnaire: "questionnaire" };

/**
 * @param {Study} study
 * @param {number | null} left_s Of the training period; null without one.
 * @param {boolean} reached Whether the running trial's target is reached.
 * @returns {Button | null}
 */
export function button(study, left_s, reached) {
  const { step, doing, refusal, other_vessel } = study;
  if (!step) return null;
  if (other_vessel) return { label: `${other_vessel} is in place`, move: "vessel", may: true, due: true };
  if (!doing) {
    if (step.kind === "questionnaire") return null;
    return { label: `Begin ${NAMES[step.kind]}`, move: "next", may: refusal === "", due: true };
  }
  switch (step.kind) {
    case "training":
      return { label: "End training", move: "finish", may: true, due: left_s === null || left_s <= 0 };
    case "trial":
      return { label: "End trial", move: "finish", may: true, due: reached };
    case "questionnaire":
      return { label: after(study), move: "finish", may: study.answered === true, due: study.answered === true };
  }
}

/** What a finished questionnaire leads to. @param {Study} study */
function after({ step, own, participants }) {
  if (!step) return "";
  if (own.some((each) => each.block > step.block)) return "Next block";
  return participants.at(-1)?.code === step.code ? "Finish the study" : "Next participant";
}

/**
 * Where in the plan a step is, in words.
 * @param {Step} step
 * @param {OwnStep[]} own
 * @returns {string[]}
 */
export function whereabouts(step, own) {
  const blocks = new Set(own.map((each) => each.block)).size;
  const words = [`Block ${step.block} of ${blocks}`, step.condition.replace("_", " ")];
  if (step.kind !== "questionnaire") words.push(`vessel ${step.model}`);
  if (step.kind === "trial") {
    const alike = own.filter((each) => each.kind === "trial" && each.block === step.block && each.model === step.model);
    words.push(`trial ${step.repetition} of ${alike.length}`);
  }
  return words;
}

/** @typedef {{sign: string, title: string, status: "done" | "now" | "interrupted" | "waiting", begins: boolean}} Cell */

/**
 * A participant's steps of one block as cells: every attempt has one, so a repeat follows what was interrupted.
 * @param {OwnStep[]} steps
 * @param {string | null} due Id of the step whose turn it is.
 * @returns {Cell[]}
 */
export function cells(steps, due) {
  const found = /** @type {Cell[]} */ ([]);
  let model = "";
  for (const step of steps) {
    const name = step.kind === "trial" ? `trial ${step.repetition}, ${step.model}` : NAMES[step.kind];
    const sign = step.kind === "trial" ? String(step.repetition) : NAMES[step.kind].charAt(0).toUpperCase();
    const begins = step.kind === "questionnaire" || (step.kind === "trial" && step.model !== model);
    if (step.kind === "trial") model = step.model;
    for (let attempt = 0; attempt < step.interrupted; attempt += 1) {
      const first = begins && attempt === 0;
      found.push({ sign: "✕", title: `${name}: interrupted`, status: "interrupted", begins: first });
    }
    const again = step.interrupted > 0 ? " again" : "";
    const status = step.status === "done" ? "done" : step.id === due ? "now" : "waiting";
    const says = { done: "done", now: step.status === "started" ? "under way" : "due", waiting: "to come" }[status];
    const mark = status === "done" ? "✓" : step.interrupted > 0 ? `${sign}↻` : sign;
    found.push({ sign: mark, title: `${name}${again}: ${says}`, status, begins: begins && step.interrupted === 0 });
  }
  return found;
}

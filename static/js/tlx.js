/**
 * The questionnaire after a trial: introduction, pairs, scales, thanks. A reload loses no answer.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, setText } from "./dom.js";
import { Pairs } from "./tlx-pairs.js";
import { Scales } from "./tlx-scales.js";

/** @import { Choice, Scale } from "./tlx-pairs.js" */

/**
 * @typedef {object} Form
 * @property {string} trial
 * @property {string} participant
 * @property {"human" | "simulated"} operator_kind
 * @property {boolean} simulated_rig
 * @property {"running" | "ended" | "interrupted"} status
 * @property {boolean} filled
 * @property {boolean} may_answer
 * @property {Scale[]} scales
 * @property {number} mark_step
 * @property {[string, string][]} pairs
 */

/** @typedef {{choices: Choice[], ratings: Record<string, number>}} Draft */

const STEPS = /** @type {const} */ (["intro", "pairs", "scales", "done", "filled"]);
const trial = new URLSearchParams(location.search).get("trial") ?? "";
const path = `/trials/${encodeURIComponent(trial)}/tlx`;
const kept = `mrnav-tlx-${trial}`;
const handIn = byId("hand-in", HTMLButtonElement);
let replace = false;

/** @param {typeof STEPS[number]} wanted */
function go(wanted) {
  tell("");
  for (const name of STEPS) byId(`step-${name}`, HTMLElement).hidden = name !== wanted;
  byId(`step-${wanted}`, HTMLElement).focus();
  scrollTo(0, 0);
}

/** @param {string} text "" for nothing. */
function tell(text) {
  byId("told", HTMLElement).hidden = text === "";
  setText(byId("told-text", HTMLElement), text);
}

/** @param {Form} form Why it cannot be answered; "" if it can. */
function refusal(form) {
  if (form.operator_kind === "simulated") return "This trial had a simulated operator. Only people feel workload.";
  if (form.status === "running") return "This trial still runs. End it first, then load this page again.";
  if (!form.may_answer) return "You may only watch. Open this page with the operator's address.";
  return "";
}

/** @returns {Draft} */
function draft() {
  try {
    const found = JSON.parse(sessionStorage.getItem(kept) ?? "");
    return { choices: found.choices, ratings: found.ratings };
  } catch {
    return { choices: [], ratings: {} };
  }
}

/** @param {Form} form */
function ask(form) {
  const before = draft();
  const keep = () => {
    sessionStorage.setItem(kept, JSON.stringify({ choices: pairs.choices, ratings: scales.ratings }));
  };
  const scales = new Scales(form.scales, form.mark_step, before.ratings, keep);
  const pairs = new Pairs(form.scales, form.pairs, before.choices, {
    onChange: keep,
    onDone: () => {
      keep();
      go("scales");
    },
  });
  const begin = () => {
    go("pairs");
    pairs.show();
  };
  byId("begin", HTMLButtonElement).addEventListener("click", begin);
  byId("scales-back", HTMLButtonElement).addEventListener("click", begin);
  byId("again", HTMLButtonElement).addEventListener("click", () => {
    replace = true;
    go("intro");
  });
  handIn.addEventListener("click", async () => {
    const missing = scales.showMissing();
    if (missing > 0) {
      tell(missing === 1 ? "One scale has no mark yet." : `${missing} scales have no mark yet.`);
      return;
    }
    handIn.disabled = true;
    try {
      await request("POST", path, { ratings: scales.ratings, choices: pairs.choices, replace });
      sessionStorage.removeItem(kept);
      go("done");
    } catch (error) {
      tell(`${explain(error)} Your answers are still here: try again.`);
    } finally {
      handIn.disabled = false;
    }
  });
  go(form.filled ? "filled" : "intro");
}

async function start() {
  if (!trial) {
    tell("Which trial? Open the questionnaire from the dashboard or the results, after the trial.");
    return;
  }
  try {
    const form = /** @type {Form} */ (await request("GET", `${path}/form`));
    setText(byId("participant", HTMLElement), form.participant);
    setText(byId("trial", HTMLElement), form.trial);
    byId("simulated", HTMLElement).hidden = !form.simulated_rig;
    const why = refusal(form);
    if (why) tell(why);
    else ask(form);
  } catch (error) {
    tell(explain(error));
  }
}

void start();

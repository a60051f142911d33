/**
 * The results: every recorded trial in a list, one of them in detail; a running one live.
 * @module
 */

import { ApiError, explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { fixed } from "./format.js";
import { CONDITIONS, isGivenUp, TrialDetail } from "./results-trial.js";

/** @import { Metrics, Results, TrialSummary } from "./results-types.js" */

const REFRESH_MS = 1000;
const LIST_EVERY = 5;

const rows = byId("trials", HTMLElement);
const note = byId("list-note", HTMLElement);
const buttons = /** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[data-kind][aria-pressed]"));
const detail = new TrialDetail((id) => void makeReport(id));

/** @type {Results} */ let results = { flags: {}, trials: [] };
let chosen = new URLSearchParams(location.search).get("trial");
let kind = "all";
/** What the list shows now, to leave it alone while nothing changes. */
let drawn = "";
let ticks = 0;

async function load() {
  try {
    results = /** @type {Results} */ (await request("GET", "/results"));
    draw();
  } catch (error) {
    const signedOut = error instanceof ApiError && error.status === 401;
    setText(note, signedOut ? "Not signed in. Open the address with the token that the server printed." : explain(error));
  }
}

function visible() {
  return results.trials.filter((trial) => kind === "all" || trial.operator_kind === kind);
}

function draw() {
  const shown = visible();
  if (!shown.some((trial) => trial.id === chosen)) chosen = shown[0]?.id ?? null;
  const now = JSON.stringify([kind, chosen, shown]);
  if (now === drawn) return;
  drawn = now;
  const focused = document.activeElement instanceof HTMLElement ? document.activeElement.dataset.testid : undefined;
  rows.replaceChildren(...shown.map(row));
  if (focused) rows.querySelector(`[data-testid="${CSS.escape(focused)}"]`)?.querySelector("button")?.focus();
  setText(note, shown.length > 0 ? "" : "No trials yet. Start one on the dashboard.");
  const trial = shown.find((each) => each.id === chosen);
  if (trial) detail.show(trial, results.flags);
  else byId("detail", HTMLElement).hidden = true;
}

/** @param {TrialSummary} trial */
function row(trial) {
  const { metrics } = trial;
  const simulated = trial.operator_kind === "simulated";
  const chip = make("span", { class: "chip", "data-kind": simulated ? "simulated" : "human" }, simulated ? "simulated" : "person");
  const rig = trial.simulated_rig && !simulated ? [make("span", { class: "chip", "data-kind": "simulated" }, "simulated rig")] : [];
  const pick = make(
    "button",
    { type: "button", class: "pick", "data-testid": trial.id },
    trial.participant,
    chip,
    ...rig,
    make("small", {}, [moment(trial.id), CONDITIONS[trial.condition], trial.vessel, ...(isGivenUp(trial) ? ["✕ no result"] : [])].join(" · ")),
  );
  const values = [
    fixed(metrics?.average_speed_um_per_s, 0),
    trial.status === "running" ? "runs" : fixed(metrics?.completion_s, 1),
    fixed(metrics?.straightness.value, 2),
    fixed(metrics?.smoothness.value, 2),
    fixed(metrics?.contacts, 0),
    fixed(trial.tlx?.weighted, 0),
  ];
  const line = make("tr", {}, make("th", { scope: "row" }, pick), ...values.map((value) => make("td", {}, value)));
  if (trial.id === chosen) line.setAttribute("aria-current", "true");
  line.addEventListener("click", () => choose(trial.id));
  return line;
}

/** When a trial began, as its id says. @param {string} id */
function moment(id) {
  const [, month, day, hour, minute] = /^\d{4}(\d\d)(\d\d)-(\d\d)(\d\d)/.exec(id) ?? [];
  return `${day}.${month}. ${hour}:${minute}`;
}

/** @param {string} id */
function choose(id) {
  chosen = id;
  history.replaceState(null, "", `?trial=${encodeURIComponent(id)}`);
  draw();
}

/** @param {string} id */
async function makeReport(id) {
  setText(byId("detail-note", HTMLElement), "Making the report…");
  try {
    await request("POST", `/trials/${encodeURIComponent(id)}/result`);
    detail.forget();
    await load();
  } catch (error) {
    const slow = error instanceof ApiError && error.status === 0;
    setText(byId("detail-note", HTMLElement), slow ? "Still making the report…" : explain(error));
  }
}

async function follow() {
  ticks += 1;
  const trial = results.trials.find((each) => each.id === chosen);
  if (trial?.status === "running") {
    try {
      const path = `/trials/${encodeURIComponent(trial.id)}/result`;
      const live = /** @type {{metrics: Metrics, elapsed_s?: number}} */ (await request("GET", path));
      if (chosen === trial.id) detail.showMetrics(trial, live.metrics, results.flags, live.elapsed_s);
    } catch {
      // It has ended, or has no track yet: the list says so.
    }
  }
  if (ticks % LIST_EVERY === 0) await load();
}

for (const button of buttons) {
  button.addEventListener("click", () => {
    kind = button.dataset.kind ?? "all";
    for (const each of buttons) each.setAttribute("aria-pressed", String(each === button));
    draw();
  });
}
await load();
for (;;) {
  await new Promise((resolve) => setTimeout(resolve, REFRESH_MS));
  if (!document.hidden) await follow();
}

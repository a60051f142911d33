/**
 * One trial in detail: whose it is, the five metrics, flags, path, speed.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, icon, make, setText } from "./dom.js";
import { fixed } from "./format.js";
import { PathView } from "./results-path.js";
import { SpeedChart } from "./results-speed.js";

/** @import { Metrics, Trajectory, TrialSummary } from "./results-types.js" */

export const CONDITIONS = { with_autonomy: "with autonomy", without_autonomy: "without autonomy" };

/** Whose motion it is, in a sentence that nobody overlooks. @param {Pick<TrialSummary, "operator_kind" | "simulated_rig">} trial */
export function kindOf({ operator_kind, simulated_rig }) {
  if (operator_kind === "simulated") return "Simulated operator: no evidence about people";
  return simulated_rig ? "Person on a simulated rig: the robot's motion is simulated" : "Person on a real rig";
}

/** Whether a study goes on without it: its step was interrupted, and done again. @param {TrialSummary} trial */
export function isGivenUp({ in_study, status }) {
  return in_study === false && status !== "running";
}

export class TrialDetail {
  #section = byId("detail", HTMLElement);
  #kind = byId("kind", HTMLElement);
  #five = byId("five", HTMLElement);
  #flags = byId("flags", HTMLElement);
  #more = byId("more", HTMLElement);
  #note = byId("detail-note", HTMLElement);
  #drawings = byId("drawings", HTMLElement);
  #make = byId("make", HTMLButtonElement);
  #ask = byId("ask", HTMLAnchorElement);
  #replay = byId("play-back", HTMLAnchorElement);
  #path = new PathView(byId("path", HTMLCanvasElement));
  #speed = new SpeedChart(byId("speed", HTMLElement), (at_s) => this.#path.pointAt(at_s));
  /** @type {string | null} */ #shown = null;
  /** What is drawn: a trial that ends, or gets its report, is drawn anew. */
  #drawn = "";

  /** @param {(id: string) => void} onMake A trial's report is asked for. */
  constructor(onMake) {
    this.#make.addEventListener("click", () => this.#shown && onMake(this.#shown));
  }

  /** @param {TrialSummary} trial @param {Record<string, string>} meanings Of the flags. */
  show(trial, meanings) {
    this.#section.hidden = false;
    this.#kind.dataset.kind = trial.simulated ? "simulated" : "human";
    setText(this.#kind, kindOf(trial));
    setText(byId("detail-heading", HTMLElement), trial.id);
    setText(byId("detail-about", HTMLElement), about(trial));
    this.#make.hidden = trial.status === "running" || trial.metrics !== null;
    this.#ask.hidden = trial.operator_kind !== "human" || trial.status === "running";
    this.#ask.href = `/tlx?trial=${encodeURIComponent(trial.id)}`;
    this.#replay.hidden = trial.status === "running";
    this.#replay.href = `/playback?trial=${encodeURIComponent(trial.id)}`;
    setText(this.#ask, trial.tlx ? "Questionnaire ✓" : "Questionnaire");
    this.showMetrics(trial, trial.metrics, meanings);
    this.#shown = trial.id;
    const now = [trial.id, trial.status, trial.metrics !== null].join();
    if (now !== this.#drawn) {
      this.#drawn = now;
      void this.#draw(trial);
    }
  }

  /** Draw the same trial anew at the next showing. */
  forget() {
    this.#drawn = "";
  }

  /**
   * @param {TrialSummary} trial
   * @param {Metrics | null} metrics
   * @param {Record<string, string>} meanings
   * @param {number | null} [elapsed_s] Since the go cue, while the trial runs.
   */
  showMetrics(trial, metrics, meanings, elapsed_s = null) {
    this.#five.replaceChildren(...figures(trial, metrics, elapsed_s));
    this.#more.replaceChildren(...(metrics ? further(metrics, trial) : []));
    const flags = (metrics?.flags ?? []).filter((flag) => elapsed_s === null || flag !== "not_reached");
    this.#flags.replaceChildren(
      ...flags.map((flag) => make("li", {}, icon("i-warning"), make("span", {}, meanings[flag] ?? flag))),
    );
  }

  /** @param {TrialSummary} trial */
  async #draw(trial) {
    /** @type {Trajectory | null} */ let trajectory = null;
    let note = "";
    if (trial.status === "running") {
      note = "This trial runs. Its metrics are those up to now; path and speed come when it ends.";
    } else if (trial.metrics === null) {
      note = trial.status === "interrupted" ? "This trial was interrupted and has no report." : "This trial has no report.";
    } else {
      try {
        const path = `/trials/${encodeURIComponent(trial.id)}/trajectory`;
        trajectory = /** @type {Trajectory} */ (await request("GET", path));
      } catch (error) {
        note = explain(error);
      }
    }
    if (this.#shown !== trial.id) return;
    this.#drawings.dataset.empty = String(trajectory === null);
    this.#path.show(trajectory);
    this.#speed.show(trajectory);
    setText(this.#note, note);
  }
}

/** @param {TrialSummary} trial */
function about(trial) {
  const reached = trial.reached === null ? "ended" : trial.reached ? "target reached" : "target not reached";
  const end = { running: "runs", ended: reached, interrupted: "interrupted" };
  const given = isGivenUp(trial) ? "given up: no result of the study" : "";
  const who = trial.operator_kind === "simulated" ? `simulated operator ${trial.participant}` : trial.participant;
  return [who, CONDITIONS[trial.condition], trial.vessel, end[trial.status], given, trial.notes].filter(Boolean).join(" · ");
}

/** @param {TrialSummary} trial @param {Metrics | null} metrics @param {number | null} elapsed_s */
function figures(trial, metrics, elapsed_s) {
  const rows = /** @type {const} */ ([
    ["Speed Va", fixed(metrics?.average_speed_um_per_s, 0), "µm/s", "↑ higher is faster"],
    ["Time TOC", fixed(metrics?.completion_s ?? elapsed_s, 2), "s", elapsed_s === null ? "↓ lower is faster" : "up to now"],
    ["Straightness G", fixed(metrics?.straightness.value, 2), "", "↓ lower is straighter"],
    ["Smoothness S", fixed(metrics?.smoothness.value, 2), "", "↓ lower is smoother"],
    ["Contacts C", fixed(metrics?.contacts, 0), "", "↓ lower is safer"],
    ["Workload TLX", fixed(trial.tlx?.weighted, 1), "", "↓ lower is lighter"],
  ]);
  return rows
    .filter(([name]) => name !== "Workload TLX" || trial.operator_kind === "human")
    .map(([name, value, unit, better]) =>
      make("div", {}, make("dt", {}, name), make("dd", {}, make("b", {}, value), ` ${unit}`, make("small", {}, better))),
    );
}

/** @param {Metrics} metrics @param {TrialSummary} trial */
function further(metrics, trial) {
  const rows = /** @type {[string, string][]} */ ([
    ["First motion after", `${fixed(metrics.first_motion_s, 2)} s`],
    ["Path", `${fixed(metrics.path_um / 1000, 2)} mm`],
    ["Shortest path's share SPL ↑", fixed(metrics.path_length_share, 3)],
    ["Smallest gap to the wall ↑", `${fixed(metrics.min_clearance_um, 0)} µm`],
    ["Peak speed", `${fixed(metrics.peak_speed_um_per_s, 0)} µm/s`],
    ["LDLJ ↑", fixed(metrics.log_dimensionless_jerk, 2)],
    ["SPARC ↑", fixed(metrics.spectral_arc_length, 2)],
    ["G, S of the noise alone", `${fixed(metrics.straightness_floor, 2)}, ${fixed(metrics.smoothness_floor, 2)}`],
    ["Robot seen", `${fixed(100 * metrics.seen_share, 0)} %`],
  ]);
  if (trial.tlx) rows.push(["Workload, raw ↓", fixed(trial.tlx.raw, 1)]);
  return rows.map(([name, value]) => make("tr", {}, make("th", { scope: "row" }, name), make("td", {}, value)));
}

/**
 * What the training wizard says of a vessel and of a policy. Plain functions of what is known.
 * @module
 */

/** @import { Evaluation, VesselReport } from "./training-types.js" */

/** @type {Record<string, string>} */
export const STAGES = {
  plan: "finding the shortest paths",
  clone: "learning from the planner",
  reinforce: "reinforcement learning",
  evaluate: "evaluation",
};

/** @param {number} length_um */
function mm(length_um) {
  return (length_um / 1000).toFixed(length_um < 10_000 ? 2 : 1);
}

/**
 * A vessel in figures.
 * @param {VesselReport} report
 * @returns {[string, string][]}
 */
export function facts(report) {
  const { least, median, most } = report.width_um;
  const tight_um = report.tight.reduce((sum, place) => sum + place.length_um, 0);
  const places = report.tight.length === 1 ? "1 place" : `${report.tight.length} places`;
  return [
    ["Taken as", report.drawn ? "a mask" : `a photograph, ${report.side} lumen`],
    ["Size", `${mm(report.size_um)} mm square`],
    ["Width", `${mm(least)} to ${mm(most)}, mostly ${mm(median)} mm`],
    ["Length", `${mm(report.length_um)} mm, reached ${mm(report.reached_um)}`],
    ["Junctions", String(report.junctions)],
    ["Robot does not fit", report.tight.length === 0 ? "nowhere" : `${places}, ${mm(tight_um)} mm`],
  ];
}

/**
 * How good a policy is.
 * @param {Evaluation} evaluation
 */
export function percent({ n, success, success_low, success_high, spl, wall_hits }) {
  const [mean, low, high] = [success, success_low, success_high].map((share) => (100 * share).toFixed(1));
  return (
    `${n} random tasks (simulated): success ${mean} % (95 % interval ${low} to ${high} %), ` +
    `SPL ${spl.toFixed(3)}, ${wall_hits.toFixed(2)} wall hits a task.`
  );
}

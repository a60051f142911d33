/**
 * What the training wizard's routes answer (docs/protocol.md).
 * @module
 */

/**
 * @typedef {object} VesselReport
 * @property {number} size_um Side of the square grid.
 * @property {number} length_um Of the centre line.
 * @property {number} reached_um That part of it where the robot can go.
 * @property {number} junctions
 * @property {{least: number, median: number, most: number}} width_um
 * @property {{x_px: number, y_px: number, width_um: number, length_um: number}[]} tight Where the robot does not fit.
 * @property {"bright" | "dark"} side Which part of the picture is the lumen.
 * @property {boolean} drawn Whether the picture was a mask.
 * @property {string[]} notes
 */

/**
 * @typedef {object} Progress
 * @property {string} stage
 * @property {number} share Of the whole, 0..1.
 * @property {number | null} success
 * @property {number | null} left_s
 */

/** @typedef {{n: number, success: number, success_low: number, success_high: number, spl: number, wall_hits: number}} Evaluation */

/**
 * Where the wizard stands.
 * @typedef {object} TrainingState
 * @property {"idle" | "importing" | "imported" | "training" | "trained" | "failed"} phase
 * @property {{name: string, own: boolean, in_use: boolean}[]} models
 * @property {string[]} presets
 * @property {string} objection Why nothing may be begun now.
 * @property {string} refusal Why the last one failed.
 * @property {string} used What became of the policy.
 * @property {"import" | "training"} [kind]
 * @property {string} [model]
 * @property {string} [preset]
 * @property {number} [seed]
 * @property {VesselReport} [report]
 * @property {Progress} [progress]
 * @property {Evaluation} [evaluation]
 */

export {};

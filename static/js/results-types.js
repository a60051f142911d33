/**
 * What the results' interface answers (docs/protocol.md). Units are in the names.
 * @module
 */

/** @import { Mode, Pair } from "./types.js" */

/** @typedef {{value: number | null, samples: number, moving_share: number, floored_share: number}} MedianLog */

/**
 * Null where the motion does not define a value.
 * @typedef {object} Metrics
 * @property {number | null} average_speed_um_per_s
 * @property {number | null} completion_s
 * @property {number | null} first_motion_s
 * @property {MedianLog} straightness
 * @property {number | null} straightness_floor
 * @property {MedianLog} smoothness
 * @property {number | null} smoothness_floor
 * @property {number} contacts
 * @property {number | null} min_clearance_um
 * @property {number | null} log_dimensionless_jerk
 * @property {number | null} spectral_arc_length
 * @property {number | null} path_length_share
 * @property {number} path_um
 * @property {number | null} peak_speed_um_per_s
 * @property {number} seen_share
 * @property {string[]} flags
 */

/**
 * @typedef {object} TrialSummary
 * @property {string} id
 * @property {"running" | "ended" | "interrupted"} status
 * @property {string} participant
 * @property {"with_autonomy" | "without_autonomy"} condition
 * @property {"human" | "simulated"} operator_kind
 * @property {boolean} simulated_rig
 * @property {boolean} simulated
 * @property {string} vessel
 * @property {string} notes
 * @property {boolean | null} reached
 * @property {boolean | null} in_study Whether it is a result of the study that is led; null without one.
 * @property {Metrics | null} metrics Null without a result.
 * @property {{weighted: number, raw: number} | null} tlx
 */

/** @typedef {{flags: Record<string, string>, trials: TrialSummary[]}} Results */

/**
 * A stretch of the filtered path without a gap; columns of equal length.
 * @typedef {object} Part
 * @property {number[]} t_s Since the go cue.
 * @property {number[]} x_px In the vessel's grid.
 * @property {number[]} y_px
 * @property {number[]} speed_um_per_s
 * @property {(Mode | "")[]} mode
 */

/**
 * @typedef {object} Trajectory
 * @property {string} id
 * @property {boolean} simulated
 * @property {number} size_px
 * @property {number} um_per_px
 * @property {number} robot_radius_px
 * @property {Pair[][]} walls_px
 * @property {Pair | null} start_px
 * @property {Pair | null} area_px
 * @property {number | null} area_epsilon_um
 * @property {Part[]} parts
 * @property {{t_s: number, x_px: number, y_px: number}[]} contacts
 */

export {};

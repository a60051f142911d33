/**
 * Messages of the twin stream, from their schema, and of the REST interface (docs/protocol.md).
 * Units are in the names; frames: `_px` with a word before it, `_um` in the stage frame.
 * @module
 */

/** @typedef {import("./twin-types.js").Answer} Answer */
/** @typedef {import("./twin-types.js").CriticalArea} CriticalArea */
/** @typedef {import("./twin-types.js").HandLease} HandLease */
/** @typedef {import("./twin-types.js").HandMessage} HandMessage */
/** @typedef {import("./twin-types.js").Lease} Lease */
/** @typedef {import("./twin-types.js").Mode} Mode */
/** @typedef {import("./twin-types.js").Percentiles} Percentiles */
/** @typedef {import("./twin-types.js").Policy} Policy */
/** @typedef {import("./twin-types.js").Snapshot} Snapshot */
/** @typedef {import("./twin-types.js").State} State */
/** @typedef {import("./twin-types.js").TwinEvent} TwinEvent */
/** @typedef {import("./twin-types.js").VesselPoint} VesselPoint */
/** @typedef {import("./twin-types.js").ServerMessage} TwinMessage */
/** @typedef {Snapshot["role"]} Role */
/** @typedef {State["severity"]} Severity */
/** @typedef {import("./twin-types.js").AskMessage["ask"]} Ask */
/** @typedef {[number, number]} Pair */
/** @typedef {[number, number, number]} Triple */
/** @typedef {[Triple, Triple]} AffineRows Rows `[a, b, tx], [c, d, ty]`. */

/**
 * Where the vessel model lies, relative to where the calibration has it.
 * @typedef {object} RegistrationAnswer
 * @property {number | null} overlap Dice coefficient of seen and modelled lumen, 0..1.
 * @property {number | null} residual_um
 * @property {{dx_um: number, dy_um: number, turn_deg: number}} pose
 * @property {Pair[][]} outline_px The model's walls in the image, closed lines.
 * @property {boolean} [accepted] In the answer to an ask.
 * @property {string} [reason]
 */

/**
 * @typedef {object} CalibrationFigure
 * @property {string} name
 * @property {number} value_um
 * @property {number | null} bound_um Beyond it the stage is refused.
 */

/**
 * Where the guided calibration stands.
 * @typedef {object} CalibrationState
 * @property {"idle" | "waiting" | "moving" | "stopping" | "done"} phase
 * @property {string | null} stage
 * @property {string} text What is to be done next.
 * @property {number} share Of the stage, 0..1.
 * @property {string | null} scene What a person is to lay down; null if nothing.
 * @property {string} refusal
 * @property {boolean} simulated
 * @property {{square_um: number, columns: number, rows: number, water_depth_um: number}} plan
 * @property {{stage: string, done: boolean, figures: CalibrationFigure[]}[]} stages
 * @property {string | null} file
 * @property {string | null} setting The line of the settings that keeps it.
 */

/** @typedef {{id: string}} Trial */
/**
 * What is known when a trial ends; figures may stand in `metrics` or beside it.
 * @typedef {Record<string, unknown>} TrialResult
 */

export {};

/**
 * What the study's interface answers (docs/study.md).
 * @module
 */

/** @typedef {"training" | "trial" | "questionnaire"} StepKind */

/**
 * @typedef {object} Step
 * @property {string} id
 * @property {string} code Who does it.
 * @property {StepKind} kind
 * @property {number} block 1 or 2: first or second condition.
 * @property {"with_autonomy" | "without_autonomy"} condition
 * @property {string} model
 * @property {number | null} repetition From 1, for a trial.
 */

/** @typedef {Step & {status: "waiting" | "started" | "done" | "interrupted", interrupted: number}} OwnStep */
/** @typedef {{code: string, steps: number, done: number, interrupted: number}} Participant */

/**
 * @typedef {object} Study
 * @property {number} steps
 * @property {number} done
 * @property {Participant[]} participants In the order of coming.
 * @property {OwnStep[]} own Of the participant whose turn it is.
 * @property {string} vessel Under the microscope.
 * @property {Step | null} step What is due; null once all is done.
 * @property {boolean} doing Whether it is under way.
 * @property {boolean} [again] Whether it was interrupted before.
 * @property {string | null} [trial] Its trial, or the one that its questionnaire is about.
 * @property {string} say What is to be done.
 * @property {string} refusal Why it cannot begin yet; "" if it can.
 * @property {string | null} other_vessel The vessel to be put under the microscope first.
 * @property {number} [left_s] Of a training period.
 * @property {boolean} [answered] Whether the questionnaire is.
 */

export {};

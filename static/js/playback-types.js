/**
 * What the playback's interface answers (docs/recording.md). Times are in seconds since the go cue.
 * @module
 */

/** @import { Mode, Pair } from "./types.js" */

/** @typedef {"arm" | "auto" | "announced" | "handover" | "contact" | "fault" | "recovered" | "stop" | "go" | "reached"} MarkKind */
/** @typedef {{t_s: number, kind: MarkKind, text: string}} Mark */
/** @typedef {{t_s: number, mode: Mode | "", reason: string}} Stretch From here on, until the next one. */
/** @typedef {{t_s: number, id: string | null, center_px: Pair, epsilon_um: number | null, label: string}} Goal */
/** @typedef {{t_s: number, end_s: number | null, points_px: Pair[]}} Way */

/**
 * One row a track, columns of equal length; null where something is not known.
 * @typedef {object} Frames
 * @property {number[]} t_s
 * @property {number[]} number Of the camera's picture.
 * @property {(number | null)[]} x_px In the vessel's grid.
 * @property {(number | null)[]} y_px
 * @property {(number | null)[]} tip_x_px
 * @property {(number | null)[]} tip_y_px
 * @property {(number | null)[]} hand The hand's share, 0..1; null where hand and policy drove together.
 * @property {boolean[]} clutch
 * @property {(number | null)[]} distance_um
 * @property {(number | null)[]} speed_um_per_s
 * @property {(number | null)[]} jerk_um_per_s3
 */

/**
 * @typedef {object} Playback
 * @property {string} id
 * @property {string} participant
 * @property {"with_autonomy" | "without_autonomy"} condition
 * @property {"human" | "simulated"} operator_kind
 * @property {boolean} simulated_rig
 * @property {boolean} simulated
 * @property {"ended" | "interrupted"} status
 * @property {string} vessel
 * @property {number} um_per_px
 * @property {number} size_px
 * @property {number} robot_radius_px
 * @property {Pair[][]} walls_px
 * @property {Pair | null} start_px
 * @property {Frames} frames
 * @property {Stretch[]} modes
 * @property {Goal[]} areas
 * @property {Way[]} paths
 * @property {Mark[]} marks
 * @property {number[]} film_s When each picture of the film was taken; none without a film.
 */

export {};

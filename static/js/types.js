/**
 * Messages of the twin stream and the REST interface, as docs/protocol.md defines them.
 * Units are in the names; frames: `_px` with a word before it, `_um` in the stage frame.
 * @module
 */

/** @typedef {"viewer" | "operator"} Role */
/** @typedef {"DISARMED" | "MANUAL" | "AUTO" | "HOLD" | "FAULT" | "STOP"} Mode */
/** @typedef {"NONE" | "WARN" | "HOLD" | "FAULT" | "STOP"} Severity */
/** @typedef {"arm" | "disarm" | "manual" | "auto" | "hold" | "stop" | "reset"} Ask */
/** @typedef {{x_px: number, y_px: number}} VesselPoint In the vessel's grid. */
/** @typedef {[number, number]} Pair */
/** @typedef {[number, number, number]} Triple */
/** @typedef {[Triple, Triple]} AffineRows Rows `[a, b, tx], [c, d, ty]`. */

/**
 * @typedef {object} CriticalArea
 * @property {string} id
 * @property {VesselPoint} center
 * @property {number} epsilon_um
 * @property {string} label
 * @property {boolean} active
 * @property {boolean} visited Whether autonomy has arrived there.
 */

/**
 * @typedef {object} Policy
 * @property {string} name
 * @property {string} kind
 * @property {boolean} verified
 * @property {string} reason
 */

/**
 * @typedef {object} Lease
 * @property {number} epoch
 * @property {string | null} holder Session of the hand if there is one, else of the console.
 * @property {string | null} console Session of the page that controls the rig.
 * @property {string} client The holders' own names.
 * @property {boolean} hand Whether the holder has a live hand link.
 */

/** @typedef {{p50: number, p99: number}} Percentiles In milliseconds. */

/**
 * @typedef {object} State
 * @property {"state"} type
 * @property {number} seq
 * @property {number} t
 * @property {Triple | null} tip_um
 * @property {Triple | null} setpoint_um
 * @property {Pair | null} tip_px In the image.
 * @property {Pair | null} tip_seen_px Where the tip was seen in the image at the last look.
 * @property {number | null} tip_off_um How far that was from tip_px.
 * @property {Pair | null} robot_um
 * @property {Pair | null} robot_px In the image.
 * @property {Pair | null} robot_vessel_px
 * @property {{state: "searching" | "acquiring" | "tracking", confidence: number, age_ms: number,
 *   sigma_um: number | null}} track
 * @property {Mode} mode
 * @property {Severity} severity
 * @property {string} reason
 * @property {number} authority Share of the motion that the hand commands, 0..1.
 * @property {Lease} lease
 * @property {boolean} clutch
 * @property {boolean} auto_ready
 * @property {string} auto_refusal
 * @property {number | null} time_to_handover_s
 * @property {string | null} critical_area
 * @property {number | null} distance_um
 * @property {number | null} lead_um
 * @property {{offset_um: Pair, friction_lead_um: number, looks: number}} learned
 * @property {{scale: "coarse" | "fine", gain: number, messages_hz: number, poses_hz: number}} hand
 * @property {number} collisions
 * @property {Pair[]} path In the vessel's grid.
 * @property {{hand_to_command: Percentiles, frame_to_twin: Percentiles, tick: Percentiles}} latency_ms
 * @property {{camera: number, hand: number, hand_poses: number, tick: number}} rates_hz
 * @property {Record<string, number>} counters
 * @property {string | null} trial
 */

/**
 * @typedef {object} Snapshot
 * @property {"snapshot"} type
 * @property {1} v
 * @property {string} session This connection's session.
 * @property {Role} role
 * @property {{simulated: boolean, name: string}} rig
 * @property {{name: string, size_px: number, um_per_px: number, robot_radius_um: number,
 *   suggested_areas: VesselPoint[]}} vessel
 * @property {{image_from_vessel: AffineRows, stage_from_vessel: AffineRows, um_per_px: number,
 *   floor_z_um: number, magnet_offset_um: Pair, critical_height_um: number}} calibration
 * @property {Record<string, unknown>} limits
 * @property {{width_px: number, height_px: number, fps: number, format: string}} camera
 * @property {Policy[]} policies
 * @property {CriticalArea[]} critical_areas
 * @property {State | null} state Null before the first control step.
 */

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

/**
 * @typedef {{type: "event", t: number} & (
 *   {event: "areas", critical_areas: CriticalArea[]} |
 *   {event: "handover", by: "arrival" | "takeover"} |
 *   {event: "fault", reason: string} |
 *   {event: "registration" | "calibration", calibration: Snapshot["calibration"]} |
 *   {event: "trial", mark: "start" | "go" | "reached" | "end"} |
 *   {event: "mode" | "handover_announced" | "contact" | "lease"}
 * )} TwinEvent
 */

/**
 * @typedef {object} Answer
 * @property {"answer"} type
 * @property {boolean} ok
 * @property {string} code
 * @property {string} message
 */

/** @typedef {Snapshot | State | TwinEvent | Answer} TwinMessage */

/** @typedef {{id: string}} Trial */
/**
 * What is known when a trial ends; figures may stand in `metrics` or beside it.
 * @typedef {Record<string, unknown>} TrialResult
 */

export {};

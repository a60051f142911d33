/**
 * Messages of /ws/twin. Made from their JSON Schema by `make types`: change mrnav_server/app/twin_schema.py.
 * @module
 */

/**
 * The answer to an ask, in the order of the asks.
 * @typedef {object} Answer
 * @property {"answer"} type
 * @property {boolean} ok
 * @property {string} code
 * @property {string} message
 */

/**
 * The critical areas have changed.
 * @typedef {object} AreasEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"areas"} event
 * @property {CriticalArea[]} critical_areas In the order of their visits.
 * @property {string | null} next The one to which AUTO goes if none is named.
 */

/**
 * An ask for a mode over ``/ws/twin``.
 * @typedef {object} AskMessage
 * @property {"arm" | "disarm" | "manual" | "auto" | "hold" | "stop" | "reset"} ask
 * @property {string | null} [area]
 * @property {"ask"} type
 */

/**
 * How camera, vessel and stage see each other; rows of the affine maps are [a, b, tx], [c, d, ty].
 * @typedef {object} Calibration
 * @property {[[number, number, number], [number, number, number]]} image_from_vessel
 * @property {[[number, number, number], [number, number, number]]} stage_from_vessel
 * @property {number} um_per_px
 * @property {number} floor_z_um
 * @property {[number, number]} magnet_offset_um
 * @property {number} critical_height_um
 * @property {FloorMap | null} floor_map
 */

/**
 * Another calibration holds.
 * @typedef {object} CalibrationEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"calibration"} event
 * @property {string} file
 * @property {Calibration} calibration What holds from now on.
 */

/**
 * The camera's pictures.
 * @typedef {object} Camera
 * @property {number} width_px
 * @property {number} height_px
 * @property {number} fps
 * @property {string} format What a camera or film really gives, in words; "" where nothing more is known.
 */

/**
 * @typedef {Heartbeat | AskMessage | TakeHand | GiveHand | HandMessage} ClientMessage
 */

/**
 * The robot touched a wall.
 * @typedef {object} Contact
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"contact"} event
 * @property {Mode} mode
 * @property {number} count
 */

/**
 * A place where autonomy hands over to the operator.
 * @typedef {object} CriticalArea
 * @property {string} id
 * @property {VesselPoint} center
 * @property {number} epsilon_um
 * @property {string} label
 * @property {boolean} active
 * @property {boolean} visited Whether autonomy has arrived there.
 */

/**
 * Something is wrong.
 * @typedef {object} Fault
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"fault"} event
 * @property {string} reason
 */

/**
 * The camera's whole map of the vessel's floor, where it is not affine.
 * @typedef {object} FloorMap
 * @property {[[number, number, number], [number, number, number], [number, number, number]]} homography
 * @property {[number, number]} center_px
 * @property {number} radial
 * @property {number} radius_px
 */

/**
 * A page gives the hand's seat back.
 * @typedef {object} GiveHand
 * @property {"give_hand"} type
 */

/**
 * The hand's scale was chosen.
 * @typedef {object} HandEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"hand"} event
 * @property {"coarse" | "fine"} scale
 * @property {number} gain
 */

/**
 * Whether this page is the rig's hand.
 * @typedef {object} HandLease
 * @property {"lease"} type
 * @property {boolean} lease
 * @property {string} code
 * @property {string} message
 * @property {HandTransform} [transform] Only when it just became it.
 */

/**
 * Where the fingertip is, from a page that has taken the hand's seat.
 * @typedef {object} HandMessage
 * @property {"hand"} type
 * @property {number} seq Rises with every message of the connection.
 * @property {number} t The sender's own monotonic clock, in seconds.
 * @property {[number, number, number]} p Cumulative position in metres.
 * @property {boolean} clutch
 * @property {boolean} valid Whether the hand is seen.
 * @property {number} [pose] Number of the tracker's pose; a repeated one is no motion.
 */

/**
 * How far the tip goes for the hand's motion, and how often the hand is heard.
 * @typedef {object} HandState
 * @property {"coarse" | "fine"} scale
 * @property {number} gain
 * @property {number} messages_hz
 * @property {number} poses_hz
 */

/**
 * How the rig maps the hand's motion.
 * @typedef {object} HandTransform
 * @property {number} gain
 * @property {number} fine_gain
 * @property {number} vertical_gain
 */

/**
 * Autonomy has handed over to the operator.
 * @typedef {object} Handover
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"handover"} event
 * @property {"arrival" | "takeover"} by
 * @property {number | null} distance_um
 */

/**
 * The operator will take over soon.
 * @typedef {object} HandoverAnnounced
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"handover_announced"} event
 * @property {number} in_s
 * @property {number | null} distance_um
 */

/**
 * An operator's page is alive.
 * @typedef {object} Heartbeat
 * @property {"heartbeat"} type
 */

/**
 * Over the last seconds.
 * @typedef {object} Latencies
 * @property {Percentiles} hand_to_command
 * @property {Percentiles} frame_to_twin
 * @property {Percentiles} tick
 */

/**
 * What autonomy has learnt of magnet and robot.
 * @typedef {object} Learned
 * @property {[number, number]} offset_um Along the vessel's axes.
 * @property {number} friction_lead_um
 * @property {number} looks Camera frames behind the two.
 */

/**
 * Who controls the rig.
 * @typedef {object} Lease
 * @property {number} epoch Rises at every change of holder.
 * @property {string | null} holder Seat of the hand if there is one, else of the console.
 * @property {string | null} console Seat of the page that controls the rig.
 * @property {string} client The holders' own names.
 * @property {boolean} hand Whether the holder has a live hand link.
 */

/**
 * Another controls the rig.
 * @typedef {object} LeaseEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"lease"} event
 * @property {number} epoch
 * @property {string} client
 * @property {string} [reason]
 */

/**
 * Who may move the magnet, and how.
 * @typedef {"DISARMED" | "MANUAL" | "AUTO" | "HOLD" | "FAULT" | "STOP"} Mode
 */

/**
 * The mode has changed.
 * @typedef {object} ModeEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"mode"} event
 * @property {Mode} before
 * @property {Mode} mode
 * @property {string} reason
 */

/**
 * In milliseconds.
 * @typedef {object} Percentiles
 * @property {number} p50
 * @property {number} p99
 */

/**
 * A navigation policy that is installed.
 * @typedef {object} Policy
 * @property {string} name
 * @property {string} kind
 * @property {boolean} verified Whether it may be used with this vessel model.
 * @property {string} reason If not, why.
 */

/**
 * Over the last seconds.
 * @typedef {object} Rates
 * @property {number} camera
 * @property {number} hand
 * @property {number} hand_poses
 * @property {number} tick
 */

/**
 * Something that was wrong is right again.
 * @typedef {object} Recovered
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"recovered"} event
 * @property {string} reason
 */

/**
 * The vessel was registered.
 * @typedef {object} RegistrationEvent
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"registration"} event
 * @property {VesselPose} pose
 * @property {"auto" | "hand"} by
 * @property {number | null} overlap
 * @property {"lumen" | "wall"} overlap_by
 * @property {number | null} residual_um
 * @property {Calibration} calibration What holds from now on.
 */

/**
 * What stands here.
 * @typedef {object} RigName
 * @property {boolean} simulated
 * @property {string} name
 */

/**
 * The server ends; the rig comes to rest first.
 * @typedef {object} RigStopped
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"rig_stopped"} event
 * @property {Mode} mode
 */

/**
 * @typedef {Snapshot | State | ModeEvent | HandoverAnnounced | Handover | Contact | Fault | Recovered | AreasEvent | LeaseEvent | HandEvent | RegistrationEvent | CalibrationEvent | TrialStart | TrialMark | TrialEnd | VesselChanging | RigStopped | Answer | HandLease} ServerMessage
 */

/**
 * What the simulator knows of a trial.
 * @typedef {object} SimulatedTruth
 * @property {number} collisions
 * @property {boolean} lifted
 */

/**
 * The first message: all that later states refer to.
 * @typedef {object} Snapshot
 * @property {"snapshot"} type
 * @property {1} v
 * @property {string} session This connection's secret, for the header of REST requests.
 * @property {string} seat The name under which others see this connection, as in `lease`.
 * @property {"viewer" | "operator"} role
 * @property {boolean} chief Whether this connection may take control from another operator.
 * @property {RigName} rig
 * @property {Vessel} vessel
 * @property {Calibration} calibration
 * @property {Record<string, number | null>} limits By name, units in the names.
 * @property {Camera} camera
 * @property {Policy[]} policies
 * @property {CriticalArea[]} critical_areas
 * @property {State | null} state Null before the first control step.
 */

/**
 * The whole rig at one control step.
 * @typedef {object} State
 * @property {"state"} type
 * @property {number} seq Counts published states.
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {[number, number, number] | null} tip_um Where the magnet is.
 * @property {[number, number, number] | null} setpoint_um Where the magnet should be; null while disarmed.
 * @property {[number, number] | null} tip_px Where the magnet appears in the image.
 * @property {[number, number] | null} tip_seen_px Where the magnet was seen in the image at the last look.
 * @property {number | null} tip_off_um How far that was from tip_px.
 * @property {Learned} learned
 * @property {[number, number] | null} robot_um On the stage.
 * @property {[number, number] | null} robot_px In the image.
 * @property {[number, number] | null} robot_vessel_px In the vessel's grid.
 * @property {Track} track
 * @property {Mode} mode
 * @property {"NONE" | "WARN" | "HOLD" | "FAULT" | "STOP"} severity
 * @property {string} reason Why, in plain words; "" when nothing is wrong.
 * @property {number} authority Share of the motion that the hand commands, 0..1.
 * @property {Lease} lease
 * @property {boolean} clutch
 * @property {HandState} hand
 * @property {boolean} auto_ready
 * @property {string} auto_refusal If AUTO would not be granted, why.
 * @property {number | null} time_to_handover_s
 * @property {string | null} critical_area Id of the active area.
 * @property {number | null} distance_um Robot to the active area's centre.
 * @property {number | null} lead_um How far the magnet's hold point runs ahead of the robot.
 * @property {number} collisions Wall contacts since the trial, or the arming, began.
 * @property {[number, number][]} path Planned path in the vessel's grid.
 * @property {Latencies} latency_ms
 * @property {Rates} rates_hz
 * @property {Record<string, number>} counters
 * @property {string | null} trial Id of the running trial.
 */

/**
 * A page wants to be the rig's hand; ``frame`` are the axes of its positions.
 * @typedef {object} TakeHand
 * @property {"take_hand"} type
 * @property {string} [client]
 * @property {"stage" | "webxr" | "unity"} [frame]
 */

/**
 * What the tracker says of the robot.
 * @typedef {object} Track
 * @property {TrackState} state
 * @property {number} confidence 0..1.
 * @property {number} age_ms
 * @property {number | null} sigma_um Standard deviation of the position.
 */

/**
 * What the tracker says of its own answer.
 * @typedef {"searching" | "acquiring" | "tracking"} TrackState
 */

/**
 * A trial ended.
 * @typedef {object} TrialEnd
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"trial"} event
 * @property {"end"} mark
 * @property {string} id
 * @property {number} collisions
 * @property {number} collisions_in_auto
 * @property {number | null} reached_s
 * @property {number | null} final_distance_um
 * @property {Record<string, Percentiles>} latency_ms
 * @property {boolean} simulated
 * @property {Record<string, unknown>} [video] The film, if there is one.
 * @property {SimulatedTruth} [simulated_truth] Only on a simulated rig.
 */

/**
 * First motion (`go`), or the end of a dwell in the target (`reached`).
 * @typedef {object} TrialMark
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"trial"} event
 * @property {"go" | "reached"} mark
 * @property {number} t_s When it was so, on the server's monotonic clock.
 */

/**
 * A trial began.
 * @typedef {object} TrialStart
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"trial"} event
 * @property {"start"} mark
 * @property {string} id
 */

/**
 * @typedef {ModeEvent | HandoverAnnounced | Handover | Contact | Fault | Recovered | AreasEvent | LeaseEvent | HandEvent | RegistrationEvent | CalibrationEvent | TrialStart | TrialMark | TrialEnd | VesselChanging | RigStopped} TwinEvent
 */

/**
 * The vessel model in use.
 * @typedef {object} Vessel
 * @property {string} name
 * @property {number} size_px
 * @property {number} um_per_px
 * @property {number} robot_radius_um
 * @property {VesselPoint[]} suggested_areas
 */

/**
 * Another vessel model takes the place of this one: the link breaks, and comes back to it.
 * @typedef {object} VesselChanging
 * @property {"event"} type
 * @property {number} t When, on the server's monotonic clock, in seconds.
 * @property {"vessel_changing"} event
 * @property {string} vessel
 */

/**
 * In the vessel's grid.
 * @typedef {object} VesselPoint
 * @property {number} x_px
 * @property {number} y_px
 */

/**
 * Where the vessel model lies, relative to where the calibration has it.
 * @typedef {object} VesselPose
 * @property {number} dx_um
 * @property {number} dy_um
 * @property {number} turn_deg
 */

export {};

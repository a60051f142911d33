/**
 * What the operator reads beside the picture: mode, why, how far, and what the hand does.
 * @module
 */

import { length } from "../format.js";
import { sentence } from "../guide.js";
import { COLORS } from "../marks.js";
import { canvasOf, Panel, wrapped } from "./panel.js";

/** @import { Mode, State } from "../types.js" */

const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";

/** @type {Record<Mode, string>} */
const MODE_COLORS = {
  DISARMED: "#a3adb6",
  MANUAL: "#cc79a7",
  AUTO: "#f0e442",
  HOLD: "#e8ebee",
  FAULT: "#d55e00",
  STOP: "#dc3f39",
};

/** @type {Record<Mode, string>} */
const MEANS = {
  DISARMED: "Nothing moves the magnet. Arm to begin.",
  MANUAL: "Pinch, and the magnet follows your hand.",
  AUTO: "The policy moves the magnet. Pinch to take over.",
  HOLD: "Held at rest. Pinch anew to go on.",
  FAULT: "Latched until reset.",
  STOP: "Stopped. Latched until reset.",
};

/**
 * @typedef {object} HudContent
 * @property {State | null} state
 * @property {boolean} fresh
 * @property {boolean} simulated
 * @property {boolean} seated Whether this page is the rig's hand.
 * @property {boolean} seen Whether the headset sees the hand.
 * @property {string} message
 */

export class Hud {
  #panel = new Panel(0.34, 0.42, canvasOf(680, 840));

  get mesh() {
    return this.#panel.mesh;
  }

  /** @param {HudContent} content */
  show({ state, fresh, simulated, seated, seen, message }) {
    const mode = state?.mode ?? null;
    const { value, unit } = length(state?.distance_um);
    const left_s = state?.mode === "AUTO" ? state.time_to_handover_s : null;
    const content = {
      mode: fresh && mode ? mode : "NO DATA",
      color: fresh && mode ? MODE_COLORS[mode] : COLORS.warning,
      why: fresh && mode ? sentence(state?.reason || "") || MEANS[mode] : "The server is silent: what you see is old.",
      distance: `${value} ${unit}`,
      handover: left_s === null ? "" : `Hand-over in ${Math.max(1, Math.ceil(left_s))} s`,
      hand: handText(seated, seen, state?.clutch ?? false),
      held: seated && seen && (state?.clutch ?? false),
      scale: state?.hand?.scale ?? "coarse",
      authority: Math.round((state?.authority ?? 0) * 100),
      moving: fresh && (mode === "MANUAL" || mode === "AUTO"),
      simulated,
      message: sentence(message),
    };
    this.#panel.show(content, (context, width, height) => paint(context, width, height, content));
  }
}

/** @param {boolean} seated @param {boolean} seen @param {boolean} clutch */
function handText(seated, seen, clutch) {
  if (!seated) return "Not the rig's hand";
  if (!seen) return "Not seen";
  return clutch ? "Pinched: steering" : "Seen, open";
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number} width
 * @param {number} height
 * @param {any} content
 */
function paint(context, width, height, content) {
  plate(context, width, height);
  context.textBaseline = "alphabetic";
  context.textAlign = "left";
  const left = 48;
  const room = width - 2 * left;
  context.fillStyle = content.color;
  context.beginPath();
  context.roundRect(left, 52, 12, 76, 6);
  context.fill();
  context.font = `700 84px ${FONT}`;
  context.fillText(content.mode, left + 36, 120);
  if (content.simulated) badge(context, width - left, 168, "simulated");
  context.fillStyle = COLORS.text;
  context.font = `400 30px ${FONT}`;
  wrapped(context, content.why, [left, 186 + (content.simulated ? 38 : 0)], room, 37, 4);

  rule(context, left, 352, room);
  label(context, "Distance to critical area", left, 402);
  context.fillStyle = COLORS.area;
  context.font = `600 72px ${FONT}`;
  context.fillText(content.distance, left, 476);
  if (content.handover) {
    context.fillStyle = COLORS.path;
    context.font = `600 30px ${FONT}`;
    context.textAlign = "right";
    context.fillText(content.handover, width - left, 472);
    context.textAlign = "left";
  }

  rule(context, left, 516, room);
  label(context, `Your hand, ${content.scale}`, left, 566);
  context.fillStyle = content.held ? COLORS.hand : COLORS.text;
  context.font = `600 38px ${FONT}`;
  context.fillText(content.hand, left, 614);
  context.fillStyle = COLORS.line;
  context.beginPath();
  context.roundRect(left, 640, room, 12, 6);
  context.fill();
  if (content.moving) {
    context.fillStyle = COLORS.hand;
    context.beginPath();
    context.roundRect(left, 640, (room * content.authority) / 100, 12, 6);
    context.fill();
    context.fillStyle = COLORS.path;
    context.beginPath();
    context.roundRect(left + (room * content.authority) / 100, 640, (room * (100 - content.authority)) / 100, 12, 6);
    context.fill();
  }
  label(context, content.moving ? `Hand ${content.authority} %, policy ${100 - content.authority} %` : "Nobody moves the magnet", left, 692);
  context.fillStyle = COLORS.text;
  context.font = `500 30px ${FONT}`;
  wrapped(context, content.message, [left, 752], room, 38, 2);
}

/**
 * The ground of a panel.
 * @param {CanvasRenderingContext2D} context
 * @param {number} width
 * @param {number} height
 */
export function plate(context, width, height) {
  context.fillStyle = "rgb(27 31 35 / 94%)";
  context.beginPath();
  context.roundRect(2, 2, width - 4, height - 4, 32);
  context.fill();
  context.strokeStyle = COLORS.line;
  context.lineWidth = 3;
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {string} text @param {number} x @param {number} y */
function label(context, text, x, y) {
  context.fillStyle = COLORS.muted;
  context.font = `400 28px ${FONT}`;
  context.fillText(text, x, y);
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y @param {number} width */
function rule(context, x, y, width) {
  context.fillStyle = COLORS.line;
  context.fillRect(x, y, width, 2);
}

/** @param {CanvasRenderingContext2D} context @param {number} right @param {number} y @param {string} text */
function badge(context, right, y, text) {
  context.font = `600 26px ${FONT}`;
  const width = context.measureText(text).width + 28;
  context.strokeStyle = COLORS.muted;
  context.lineWidth = 2;
  context.setLineDash([8, 6]);
  context.strokeRect(right - width, y - 30, width, 42);
  context.setLineDash([]);
  context.fillStyle = COLORS.text;
  context.fillText(text, right - width + 14, y);
}

/**
 * The buttons in the room: pressed by pointing and pinching, by touching with a finger, and STOP and Hold also
 * by looking at them while no hand is seen.
 * @module
 */

import { COLORS } from "../marks.js";
import { plate } from "./hud.js";
import { canvasOf, Panel } from "./panel.js";

/** @import { State } from "../types.js" */

/** @typedef {"stop" | "auto" | "manual" | "hold" | "mark" | "prepare" | "scale" | "place" | "leave"} Command */

const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif";
const WIDTH = 680;
const HEIGHT = 840;
const EDGE = 32;
const GAP = 20;
const STOP_HEIGHT = 180;
/** @type {Command[][]} */
const ROWS = [
  ["auto", "manual"],
  ["hold", "mark"],
  ["prepare", "scale"],
  ["place", "leave"],
];
/** What may be pressed by a look: nothing that could begin a motion. */
const BY_LOOK = new Set(["stop", "hold"]);
const LOOK_MS = 1200;
const PRESSED_MS = 250;

/**
 * @typedef {object} MenuContent
 * @property {State | null} state
 * @property {boolean} fresh
 * @property {boolean} mayAsk Whether this page is the rig's hand or its console.
 * @property {boolean} operator
 * @property {boolean} marking
 */

export class Menu {
  #panel = new Panel(0.34, 0.42, canvasOf(WIDTH, HEIGHT));
  #onPress;
  /** @type {Map<Command, {text: string, enabled: boolean, lit: boolean}>} */ #buttons = new Map();
  /** @type {Command | null} */ #pointed = null;
  /** @type {Command | null} */ #looked = null;
  #looked_ms = 0;
  /** @type {Command | null} */ #pressed = null;
  #pressed_ms = -Infinity;

  /** @param {(command: Command) => void} onPress */
  constructor(onPress) {
    this.#onPress = onPress;
  }

  get mesh() {
    return this.#panel.mesh;
  }

  /** @param {MenuContent} content */
  describe({ state, fresh, mayAsk, operator, marking }) {
    const mode = fresh && state ? state.mode : null;
    const armed = mode === "MANUAL" || mode === "AUTO" || mode === "HOLD";
    const may = mayAsk && mode !== null;
    const latched = mode === "FAULT" || mode === "STOP";
    const prepare = !mayAsk ? "Take control" : latched ? "Reset" : armed ? "Disarm" : "Arm";
    const scale = state?.hand?.scale === "fine" ? "Coarse" : "Fine";
    /** @type {[Command, string, boolean, boolean?][]} */
    const buttons = [
      ["stop", "STOP", true],
      ["auto", "Auto", may && (mode === "MANUAL" || mode === "HOLD") && (state?.auto_ready ?? false)],
      ["manual", "Take over", may && (mode === "AUTO" || mode === "HOLD")],
      ["hold", "Hold", may && (mode === "MANUAL" || mode === "AUTO")],
      ["mark", marking ? "Point and pinch" : "Mark area", operator && fresh, marking],
      ["prepare", prepare, operator && fresh],
      ["scale", scale, may && !(state?.clutch ?? false)],
      ["place", "Place here", !(state?.clutch ?? false)],
      ["leave", "Leave", true],
    ];
    this.#buttons = new Map(
      buttons.map(([name, text, enabled, lit = false]) => [name, { text, enabled, lit }]),
    );
  }

  /**
   * Which button lies at a place of the panel.
   * @param {{x: number, y: number}} uv As three.js gives it: from the lower left, 0..1.
   * @returns {Command | null}
   */
  at(uv) {
    const [x, y] = [uv.x * WIDTH, (1 - uv.y) * HEIGHT];
    for (const { name, box } of boxes()) {
      if (x >= box[0] && x <= box[0] + box[2] && y >= box[1] && y <= box[1] + box[3]) return name;
    }
    return null;
  }

  /** A ray rests on a button, or on none. @param {Command | null} command */
  point(command) {
    this.#pointed = command;
  }

  /**
   * The operator looks at a button while no hand is seen.
   * @param {Command | null} command
   * @param {number} now_ms
   */
  look(command, now_ms) {
    const wanted = command !== null && BY_LOOK.has(command) && this.#buttons.get(command)?.enabled ? command : null;
    if (wanted !== this.#looked) {
      this.#looked = wanted;
      this.#looked_ms = now_ms;
    } else if (wanted !== null && now_ms - this.#looked_ms > LOOK_MS) {
      this.press(wanted, now_ms);
      this.#looked_ms = now_ms + LOOK_MS;
    }
  }

  /** @param {Command} command @param {number} now_ms */
  press(command, now_ms) {
    if (!this.#buttons.get(command)?.enabled) return;
    this.#pressed = command;
    this.#pressed_ms = now_ms;
    this.#onPress(command);
  }

  /** @param {number} now_ms */
  draw(now_ms) {
    const pressed = now_ms - this.#pressed_ms < PRESSED_MS ? this.#pressed : null;
    const looked = this.#looked === null ? 0 : Math.max(0, Math.min(1, (now_ms - this.#looked_ms) / LOOK_MS));
    const content = [
      [...this.#buttons],
      this.#pointed,
      pressed,
      this.#looked,
      Math.round(looked * 20),
    ];
    this.#panel.show(content, (context) => {
      plate(context, WIDTH, HEIGHT);
      for (const { name, box } of boxes()) {
        const button = this.#buttons.get(name);
        if (!button) continue;
        paint(context, box, { ...button, stop: name === "stop", pointed: name === this.#pointed, pressed: name === pressed });
        if (name === this.#looked) lookBar(context, box, looked);
      }
    });
  }
}

/** @typedef {[number, number, number, number]} Box Left, top, width, height. */

/** @returns {{name: Command, box: Box}[]} */
function boxes() {
  const width = (WIDTH - 2 * EDGE - GAP) / 2;
  const top = EDGE + STOP_HEIGHT + GAP;
  const height = (HEIGHT - EDGE - top - (ROWS.length - 1) * GAP) / ROWS.length;
  return [
    { name: "stop", box: [EDGE, EDGE, WIDTH - 2 * EDGE, STOP_HEIGHT] },
    ...ROWS.flatMap((row, y) =>
      row.map((name, x) => ({
        name,
        box: /** @type {Box} */ ([EDGE + x * (width + GAP), top + y * (height + GAP), width, height]),
      })),
    ),
  ];
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Box} box
 * @param {{text: string, enabled: boolean, lit: boolean, stop: boolean, pointed: boolean, pressed: boolean}} is
 */
function paint(context, [x, y, width, height], is) {
  context.beginPath();
  context.roundRect(x, y, width, height, 20);
  const bright = is.pressed || is.lit;
  if (is.stop) context.fillStyle = is.pressed ? "#ffffff" : is.pointed ? "#dc3f39" : "#c4302b";
  else context.fillStyle = !is.enabled ? "rgb(27 31 35 / 0%)" : bright ? COLORS.text : is.pointed ? "#434c55" : "#2a3036";
  context.fill();
  context.lineWidth = is.pointed && is.enabled ? 6 : 3;
  context.strokeStyle = is.pointed && is.enabled ? "#ffffff" : is.enabled ? "rgb(0 0 0 / 0%)" : COLORS.line;
  context.stroke();
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.font = is.stop ? `700 88px ${FONT}` : `600 36px ${FONT}`;
  if (is.stop) context.fillStyle = is.pressed ? "#8c1410" : "#ffffff";
  else context.fillStyle = !is.enabled ? "#76808a" : bright ? "#131619" : COLORS.text;
  context.fillText(is.text, x + width / 2, y + height / 2 + 2);
}

/** @param {CanvasRenderingContext2D} context @param {Box} box @param {number} share */
function lookBar(context, [x, y, width, height], share) {
  context.fillStyle = "#ffffff";
  context.fillRect(x + 20, y + height - 18, (width - 40) * share, 8);
}

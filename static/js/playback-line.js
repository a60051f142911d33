/**
 * The time line of a recorded trial: who drove, how much the hand had to say, and what happened; scrubbed by pointer.
 * @module
 */

import { COLORS } from "./marks.js";
import { indexAt } from "./playback-time.js";

/** @import { MarkKind, Playback } from "./playback-types.js" */

const [MARKS, MODES, HAND] = [{ top: 4, height: 24 }, { top: 30, height: 26 }, { top: 61, height: 24 }];
const AXIS_TOP = 98;
/** Room for the lanes' names, and for half a sign. */
const [LEFT, RIGHT] = [60, 12];
const TICKS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600];
const TICK_APART = 64;
const FONT = "600 12px system-ui, sans-serif";
const SMALL = "11px system-ui, sans-serif";

/** Ground of a mode's stretch, colour of its word, and whether it is hatched: nobody drives. */
const LOOKS = /** @type {Record<string, {ground: string, word: string, hatched: boolean}>} */ ({
  AUTO: { ground: COLORS.path, word: "#131619", hatched: false },
  MANUAL: { ground: COLORS.hand, word: "#131619", hatched: false },
  HOLD: { ground: "#2a3036", word: COLORS.text, hatched: true },
  DISARMED: { ground: "#1b1f23", word: COLORS.muted, hatched: false },
  FAULT: { ground: COLORS.warning, word: "#131619", hatched: true },
  STOP: { ground: COLORS.warning, word: "#131619", hatched: false },
});

/** A sign of its own for every kind of event, and its colour. */
export const SIGNS = /** @type {Record<MarkKind, {sign: string, color: string}>} */ ({
  arm: { sign: "▲", color: COLORS.text },
  go: { sign: "▶", color: COLORS.text },
  auto: { sign: "A", color: COLORS.path },
  announced: { sign: "◷", color: COLORS.muted },
  handover: { sign: "H", color: COLORS.hand },
  contact: { sign: "✕", color: COLORS.warning },
  fault: { sign: "!", color: COLORS.warning },
  recovered: { sign: "✓", color: COLORS.text },
  stop: { sign: "■", color: COLORS.warning },
  reached: { sign: "◆", color: COLORS.area },
});

export class TimeLine {
  #canvas;
  #context;
  #trial;
  #begin_s;
  #end_s;
  #at_s = 0;

  /** @param {HTMLCanvasElement} canvas @param {Playback} trial @param {(at_s: number) => void} onSeek */
  constructor(canvas, trial, onSeek) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    this.#trial = trial;
    this.#begin_s = trial.frames.t_s[0] ?? 0;
    this.#end_s = trial.frames.t_s.at(-1) ?? 0;
    canvas.setAttribute("aria-valuemin", this.#begin_s.toFixed(2));
    canvas.setAttribute("aria-valuemax", this.#end_s.toFixed(2));
    /** @param {PointerEvent} event */
    const seek = (event) => onSeek(this.#timeAt(event.offsetX));
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) seek(event);
    });
    new ResizeObserver(() => this.#draw()).observe(canvas);
  }

  /** @param {number} at_s @param {string} mode */
  show(at_s, mode) {
    this.#at_s = at_s;
    this.#canvas.setAttribute("aria-valuenow", at_s.toFixed(2));
    this.#canvas.setAttribute("aria-valuetext", `${at_s.toFixed(2)} seconds, ${mode}`);
    this.#draw();
  }

  /** @param {number} x */
  #timeAt(x) {
    const share = (x - LEFT) / Math.max(this.#canvas.clientWidth - LEFT - RIGHT, 1);
    return this.#begin_s + Math.min(Math.max(share, 0), 1) * (this.#end_s - this.#begin_s);
  }

  /** @param {number} at_s */
  #x(at_s) {
    const share = (at_s - this.#begin_s) / Math.max(this.#end_s - this.#begin_s, 1e-9);
    return LEFT + Math.min(Math.max(share, 0), 1) * (this.#canvas.clientWidth - LEFT - RIGHT);
  }

  #draw() {
    const [canvas, context] = [this.#canvas, this.#context];
    const density = window.devicePixelRatio;
    canvas.width = Math.round(canvas.clientWidth * density);
    canvas.height = Math.round(canvas.clientHeight * density);
    context.setTransform(density, 0, 0, density, 0, 0);
    context.textBaseline = "middle";
    this.#drawNames();
    this.#drawModes();
    this.#drawHand();
    this.#drawTicks();
    this.#drawMarks();
    const x = this.#x(this.#at_s);
    context.fillStyle = COLORS.text;
    context.fillRect(x - 1, 0, 2, canvas.clientHeight - 16);
    context.beginPath();
    context.moveTo(x - 6, 0);
    context.lineTo(x + 6, 0);
    context.lineTo(x, 8);
    context.fill();
  }

  #drawModes() {
    const context = this.#context;
    const { modes } = this.#trial;
    context.font = FONT;
    context.textAlign = "left";
    modes.forEach(({ t_s, mode }, i) => {
      const [left, right] = [this.#x(t_s), this.#x(modes[i + 1]?.t_s ?? this.#end_s)];
      const look = LOOKS[mode];
      if (!look || right - left < 0.5) return;
      context.fillStyle = look.ground;
      context.fillRect(left, MODES.top, right - left, MODES.height);
      if (look.hatched) this.#hatch(left, right, MODES);
      context.fillStyle = COLORS.casing;
      context.fillRect(left, MODES.top, 1, MODES.height);
      const fits = [mode, mode.charAt(0)].find((word) => context.measureText(word).width + 12 <= right - left);
      if (!fits) return;
      if (look.hatched) {
        context.fillStyle = look.ground;
        context.fillRect(left + 3, MODES.top + 4, context.measureText(fits).width + 6, MODES.height - 8);
      }
      context.fillStyle = look.word;
      context.fillText(fits, left + 6, MODES.top + MODES.height / 2 + 1);
    });
  }

  /** How much the hand has to say, as a height; a bar below it while its clutch is closed. */
  #drawHand() {
    const context = this.#context;
    const { hand, clutch } = this.#trial.frames;
    const [room, bottom] = [HAND.height - 8, HAND.top + HAND.height - 6];
    context.fillStyle = "#1b1f23";
    context.fillRect(LEFT, HAND.top, this.#canvas.clientWidth - LEFT - RIGHT, HAND.height);
    context.fillStyle = COLORS.hand;
    this.#fillSteps((i) => (hand[i] ?? 0) * room, bottom);
    context.globalAlpha = 0.4;
    this.#fillSteps((i) => (hand[i] === null ? room : 0), bottom);
    context.globalAlpha = 1;
    context.fillStyle = COLORS.text;
    this.#fillSteps((i) => (clutch[i] ? 3 : 0), bottom + 5);
  }

  /** @param {(i: number) => number} height Of a track. @param {number} bottom */
  #fillSteps(height, bottom) {
    const context = this.#context;
    const { t_s } = this.#trial.frames;
    context.beginPath();
    context.moveTo(this.#x(this.#begin_s), bottom);
    t_s.forEach((at_s, i) => {
      const top = bottom - height(i);
      context.lineTo(this.#x(at_s), top);
      context.lineTo(this.#x(t_s[i + 1] ?? at_s), top);
    });
    context.lineTo(this.#x(this.#end_s), bottom);
    context.fill();
  }

  #drawNames() {
    const context = this.#context;
    context.font = SMALL;
    context.textAlign = "left";
    context.fillStyle = COLORS.muted;
    for (const [name, { top, height }] of /** @type {const} */ ([["Events", MARKS], ["Mode", MODES], ["Hand", HAND]])) {
      context.fillText(name, 8, top + height / 2);
    }
  }

  #drawTicks() {
    const context = this.#context;
    const span_s = this.#end_s - this.#begin_s;
    const most = Math.max((this.#canvas.clientWidth - LEFT - RIGHT) / TICK_APART, 1);
    const step_s = TICKS_S.find((tick_s) => span_s / tick_s <= most) ?? 1200;
    context.font = SMALL;
    context.textAlign = "center";
    for (let k = Math.ceil(this.#begin_s / step_s); k * step_s <= this.#end_s; k += 1) {
      const x = this.#x(k * step_s);
      context.fillStyle = COLORS.line;
      context.fillRect(x, MODES.top + MODES.height, 1, AXIS_TOP - MODES.top - MODES.height - 8);
      context.fillStyle = COLORS.muted;
      context.fillText(`${Number((k * step_s).toFixed(1))} s`, Math.min(Math.max(x, 16), this.#canvas.clientWidth - 16), AXIS_TOP - 1);
    }
  }

  #drawMarks() {
    const context = this.#context;
    context.textAlign = "center";
    let free = -Infinity;
    for (const { t_s, kind } of this.#trial.marks) {
      const { sign, color } = SIGNS[kind];
      const x = this.#x(t_s);
      context.fillStyle = color;
      context.fillRect(x - 0.5, MARKS.top + MARKS.height - 6, 1.5, 8);
      // Close ones stand beside each other, each above its own tick as far as there is room.
      const at = Math.max(x, free);
      free = at + 15;
      context.font = FONT;
      context.fillText(sign, at, MARKS.top + 10);
    }
  }

  /** @param {number} left @param {number} right @param {{top: number, height: number}} lane */
  #hatch(left, right, { top, height }) {
    const context = this.#context;
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, height);
    context.clip();
    context.beginPath();
    for (let x = left - height; x < right; x += 7) {
      context.moveTo(x, top + height);
      context.lineTo(x + height, top);
    }
    context.lineWidth = 1.5;
    context.strokeStyle = COLORS.muted;
    context.globalAlpha = 0.5;
    context.stroke();
    context.restore();
  }

  /** The event that was last at a moment. @param {number} at_s */
  eventAt(at_s) {
    const times = this.#trial.marks.map((mark) => mark.t_s);
    return times.length > 0 && (times[0] ?? 0) <= at_s + 1e-6 ? indexAt(times, at_s) : -1;
  }
}

/**
 * The vessel at one moment of a recorded trial: robot, tip, path, critical area, and the way so far.
 * @module
 */

import { COLORS, criticalArea, pathLine, robotRing, scaleBar, tipCross } from "./marks.js";
import { inForce } from "./playback-time.js";
import { drawVessel, drawWatermark } from "./vessel-drawing.js";

/** @import { Playback } from "./playback-types.js" */
/** @import { Pair } from "./types.js" */

const SCALE_BAR_UM = 2000;
/** The way to come is faint. */
const FAINT = 0.25;
const WAYS = /** @type {const} */ ({
  auto: { color: COLORS.path, dash: [] },
  manual: { color: COLORS.hand, dash: [6, 4] },
  rest: { color: COLORS.camera, dash: [2, 3] },
});

export class PlaybackMap {
  #canvas;
  #context;
  #trial;
  /** Who drove at each track. @type {(keyof typeof WAYS)[]} */ #drivers;
  #at_s = 0;
  #index = 0;

  /** @param {HTMLCanvasElement} canvas @param {Playback} trial */
  constructor(canvas, trial) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    this.#trial = trial;
    this.#drivers = trial.frames.t_s.map((t_s) => {
      const mode = inForce(trial.modes, t_s)?.mode;
      return mode === "AUTO" ? "auto" : mode === "MANUAL" ? "manual" : "rest";
    });
    new ResizeObserver(() => this.#draw()).observe(canvas);
  }

  /** @param {number} at_s @param {number} index The track of that moment. */
  show(at_s, index) {
    this.#at_s = at_s;
    this.#index = index;
    this.#draw();
  }

  #draw() {
    const [canvas, context, trial] = [this.#canvas, this.#context, this.#trial];
    const density = window.devicePixelRatio;
    const size = canvas.clientWidth;
    if (!size) return;
    canvas.width = canvas.height = Math.round(size * density);
    context.setTransform(density, 0, 0, density, 0, 0);
    const zoom = size / trial.size_px;
    /** @param {number} x @param {number} y @returns {Pair} */
    const place = (x, y) => [(x + 0.5) * zoom, (y + 0.5) * zoom];
    drawVessel(context, trial.walls_px, place);
    if (trial.simulated) drawWatermark(context, size);
    const goal = inForce(trial.areas, this.#at_s);
    if (goal) {
      const radius = ((goal.epsilon_um ?? 0) / trial.um_per_px) * zoom;
      criticalArea(context, place(...goal.center_px), radius, "", { chosen: true, active: false });
    }
    context.globalAlpha = FAINT;
    this.#drawWay(this.#index, this.#drivers.length - 1, place);
    context.globalAlpha = 1;
    this.#drawWay(0, this.#index, place);
    const way = inForce(trial.paths, this.#at_s);
    if (way && (way.end_s === null || this.#at_s < way.end_s)) pathLine(context, way.points_px.map(([x, y]) => place(x, y)));
    const { x_px, y_px, tip_x_px, tip_y_px } = trial.frames;
    const robot = pair(x_px[this.#index], y_px[this.#index]);
    if (robot) robotRing(context, place(...robot), trial.robot_radius_px * zoom, true);
    const tip = pair(tip_x_px[this.#index], tip_y_px[this.#index]);
    if (tip) tipCross(context, place(...tip));
    const bar = (SCALE_BAR_UM / trial.um_per_px) * zoom;
    scaleBar(context, bar, `${SCALE_BAR_UM / 1000} mm`, size);
  }

  /** @param {number} from @param {number} to @param {(x: number, y: number) => Pair} place */
  #drawWay(from, to, place) {
    const context = this.#context;
    const { x_px, y_px } = this.#trial.frames;
    context.lineWidth = 2.25;
    context.lineJoin = "round";
    let begin = from;
    while (begin < to) {
      const driver = this.#drivers[begin] ?? "rest";
      let end = begin;
      while (end < to && this.#drivers[end] === driver) end += 1;
      context.beginPath();
      let down = false;
      for (let i = begin; i <= end; i += 1) {
        const at = pair(x_px[i], y_px[i]);
        if (at && down) context.lineTo(...place(...at));
        else if (at) context.moveTo(...place(...at));
        down = at !== null;
      }
      context.strokeStyle = WAYS[driver].color;
      context.setLineDash(WAYS[driver].dash);
      context.stroke();
      begin = end;
    }
    context.setLineDash([]);
    context.lineJoin = "miter";
  }
}

/** @param {number | null | undefined} x @param {number | null | undefined} y @returns {Pair | null} */
function pair(x, y) {
  return typeof x === "number" && typeof y === "number" ? [x, y] : null;
}

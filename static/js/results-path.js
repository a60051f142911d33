/**
 * A trial's path over its vessel: who drove, where it began, the critical area, the contacts.
 * @module
 */

import { COLORS, criticalArea, robotRing, scaleBar } from "./marks.js";
import { drawVessel, drawWatermark } from "./vessel-drawing.js";

/** @import { Trajectory } from "./results-types.js" */
/** @import { Pair } from "./types.js" */

const SCALE_BAR_UM = 2000;
/** Colour and dash by who drove; the dash says it again. */
const DRIVERS = /** @type {Record<string, {color: string, dash: number[]}>} */ ({
  AUTO: { color: COLORS.path, dash: [] },
  MANUAL: { color: COLORS.hand, dash: [7, 4] },
});
const NOBODY = { color: COLORS.camera, dash: [2, 3] };

export class PathView {
  #canvas;
  #context;
  /** @type {Trajectory | null} */ #trajectory = null;
  /** Seconds since the go cue that are pointed at. @type {number | null} */ #at_s = null;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    new ResizeObserver(() => this.#draw()).observe(canvas);
  }

  /** @param {Trajectory | null} trajectory */
  show(trajectory) {
    this.#trajectory = trajectory;
    this.#at_s = null;
    this.#canvas.dataset.state = trajectory ? "drawn" : "empty";
    this.#draw();
  }

  /** Mark where the robot was. @param {number | null} at_s */
  pointAt(at_s) {
    this.#at_s = at_s;
    this.#draw();
  }

  #draw() {
    const canvas = this.#canvas;
    const context = this.#context;
    const density = window.devicePixelRatio;
    canvas.width = Math.round(canvas.clientWidth * density);
    canvas.height = Math.round(canvas.clientHeight * density);
    const trajectory = this.#trajectory;
    if (!trajectory || !canvas.width) return;
    context.setTransform(density, 0, 0, density, 0, 0);
    const zoom = canvas.clientWidth / trajectory.size_px;
    /** @param {number} x @param {number} y @returns {Pair} */
    const place = (x, y) => [(x + 0.5) * zoom, (y + 0.5) * zoom];
    drawVessel(context, trajectory.walls_px, place);
    if (trajectory.simulated) drawWatermark(context, canvas.clientWidth);
    if (trajectory.area_px && trajectory.area_epsilon_um !== null) {
      const radius = (trajectory.area_epsilon_um / trajectory.um_per_px) * zoom;
      criticalArea(context, place(...trajectory.area_px), radius, "", { chosen: true, active: false });
    }
    this.#drawPath(trajectory, place);
    const radius = trajectory.robot_radius_px * zoom;
    if (trajectory.start_px) robotRing(context, place(...trajectory.start_px), radius, true);
    for (const { x_px, y_px } of trajectory.contacts) this.#drawCross(place(x_px, y_px));
    this.#drawPointed(trajectory, place);
    const bar = (SCALE_BAR_UM / trajectory.um_per_px) * zoom;
    scaleBar(context, bar, `${SCALE_BAR_UM / 1000} mm`, canvas.clientHeight);
  }

  /** @param {Trajectory} trajectory @param {(x: number, y: number) => Pair} place */
  #drawPath({ parts }, place) {
    const context = this.#context;
    context.lineJoin = "round";
    for (const { x_px, y_px, mode } of parts) {
      let from = 0;
      for (let i = 1; i <= mode.length; i += 1) {
        if (i < mode.length && mode[i] === mode[from]) continue;
        const { color, dash } = DRIVERS[mode[from] ?? ""] ?? NOBODY;
        context.beginPath();
        // One sample more joins the pieces where the driver changes.
        for (let k = from; k <= Math.min(i, mode.length - 1); k += 1) {
          context.lineTo(...place(x_px[k] ?? 0, y_px[k] ?? 0));
        }
        context.setLineDash([]);
        context.lineWidth = 5;
        context.strokeStyle = COLORS.casing;
        context.stroke();
        context.setLineDash(dash);
        context.lineWidth = 2.25;
        context.strokeStyle = color;
        context.stroke();
        from = i;
      }
    }
    context.setLineDash([]);
    context.lineJoin = "miter";
  }

  /** @param {Pair} at */
  #drawCross([x, y]) {
    const context = this.#context;
    context.beginPath();
    for (const side of [-1, 1]) {
      context.moveTo(x - 7, y - 7 * side);
      context.lineTo(x + 7, y + 7 * side);
    }
    context.lineWidth = 6;
    context.strokeStyle = COLORS.casing;
    context.stroke();
    context.lineWidth = 3;
    context.strokeStyle = COLORS.warning;
    context.stroke();
  }

  /** @param {Trajectory} trajectory @param {(x: number, y: number) => Pair} place */
  #drawPointed({ parts, robot_radius_px, size_px }, place) {
    const at_s = this.#at_s;
    if (at_s === null) return;
    for (const { t_s, x_px, y_px } of parts) {
      const i = t_s.findIndex((t) => t >= at_s);
      const [x, y] = [x_px[i], y_px[i]];
      if (x === undefined || y === undefined) continue;
      const context = this.#context;
      context.beginPath();
      context.arc(...place(x, y), (robot_radius_px / size_px) * this.#canvas.clientWidth, 0, 2 * Math.PI);
      context.fillStyle = COLORS.robot;
      context.fill();
      return;
    }
  }
}

/**
 * The live microscope picture as a panel in the room, with the dashboard's marks.
 * @module
 */

import { apply, scaleOf } from "../geometry.js";
import { criticalArea, pathLine, robotRing, tag, tipCross } from "../marks.js";
import { VideoView } from "../video.js";
import { canvasOf, Panel } from "./panel.js";

/** @import { CriticalArea, Pair, Snapshot, State } from "../types.js" */

const WIDTH = 800;
const HEIGHT = 600;
const STALE_MS = 500;
const FRAME_MS = 1000 / 30;

export class Microscope {
  #panel = new Panel(0.56, 0.42, canvasOf(WIDTH, HEIGHT));
  #canvas = canvasOf(WIDTH, HEIGHT);
  #video = new VideoView(this.#canvas, { onFirstFrame: () => undefined });
  #painted_ms = -Infinity;

  get mesh() {
    return this.#panel.mesh;
  }

  /** Connect, and stay connected. */
  start() {
    void this.#video.start();
  }

  /**
   * @param {Snapshot} snapshot
   * @param {State} state
   * @param {CriticalArea[]} areas
   * @param {number} now_ms
   */
  show(snapshot, state, areas, now_ms) {
    if (now_ms - this.#painted_ms < FRAME_MS) return;
    this.#painted_ms = now_ms;
    this.#panel.repaint((context, width, height) => {
      context.save();
      context.beginPath();
      context.roundRect(0, 0, width, height, 16);
      context.clip();
      const live = now_ms - this.#video.last_ms <= STALE_MS;
      context.globalAlpha = live ? 1 : 0.4;
      context.drawImage(this.#canvas, 0, 0, width, height);
      context.globalAlpha = 1;
      this.#marks(context, width / snapshot.camera.width_px, snapshot, state, areas);
      if (!live) tag(context, [width / 2, height / 2], "Picture is not live");
      context.restore();
    });
  }

  /**
   * Which point of the image lies at a place of the panel.
   * @param {{x: number, y: number}} uv From the lower left, 0..1.
   * @param {Snapshot} snapshot
   * @returns {Pair}
   */
  imagePoint(uv, snapshot) {
    return [uv.x * snapshot.camera.width_px, (1 - uv.y) * snapshot.camera.height_px];
  }

  /**
   * @param {CanvasRenderingContext2D} context
   * @param {number} scale Pixels of the panel for a pixel of the image.
   * @param {Snapshot} snapshot
   * @param {State} state
   * @param {CriticalArea[]} areas
   */
  #marks(context, scale, snapshot, state, areas) {
    const { calibration, vessel } = snapshot;
    /** @param {Pair} image_px @returns {Pair} */
    const place = ([x, y]) => [x * scale, y * scale];
    const px_per_um = (scaleOf(calibration.image_from_vessel) / vessel.um_per_px) * scale;
    for (const { id, center, epsilon_um, label, active } of areas) {
      const at = place(apply(calibration.image_from_vessel, [center.x_px, center.y_px]));
      criticalArea(context, at, epsilon_um * px_per_um, label || id, { chosen: active, active });
    }
    pathLine(context, state.path.map((point) => place(apply(calibration.image_from_vessel, point))));
    const sure = state.track.state === "tracking";
    if (state.robot_px) robotRing(context, place(state.robot_px), vessel.robot_radius_um * px_per_um, sure);
    if (state.tip_px) tipCross(context, place(state.tip_px));
  }
}

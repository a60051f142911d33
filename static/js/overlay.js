/**
 * What is drawn over the microscope's picture, and where on the specimen a pointer points.
 * @module
 */

import { apply, scaleOf } from "./geometry.js";
import { criticalArea, outline, pathLine, robotRing, scaleBar, tag, tipCross, tipSeen } from "./marks.js";

/** @import { CriticalArea, Pair, Snapshot, State } from "./types.js" */

const SCALE_BAR_UM = 2000;

/**
 * @typedef {object} Scene
 * @property {Snapshot} snapshot
 * @property {State} state
 * @property {CriticalArea[]} areas
 * @property {string | null} chosen Id of the area that Auto would go to.
 * @property {number} newEpsilon_um Radius of an area marked now.
 * @property {Pair[][]} outline_px The vessel model's walls in the image; none while nobody registers.
 * @property {boolean} mayMark Whether a click marks an area.
 */

export class Overlay {
  #canvas;
  #context;
  #onMark;
  #onChoose;
  /** @type {Scene | null} */ #scene = null;
  /** Pointer over the picture, in CSS pixels. @type {Pair | null} */ #pointer = null;
  #pending = false;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{onMark: (image_px: Pair) => void, onChoose: (id: string) => void}} handlers
   */
  constructor(canvas, { onMark, onChoose }) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    this.#onMark = onMark;
    this.#onChoose = onChoose;
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("pointermove", (event) => this.#hover(event.pointerType === "mouse" ? event : null));
    canvas.addEventListener("pointerleave", () => this.#hover(null));
    canvas.addEventListener("click", (event) => this.#click([event.offsetX, event.offsetY]));
  }

  /** Draw this scene at the next repaint. @param {Scene} scene */
  show(scene) {
    this.#scene = scene;
    this.#request();
  }

  #request() {
    if (this.#pending) return;
    this.#pending = true;
    requestAnimationFrame(() => {
      this.#pending = false;
      this.#draw();
    });
  }

  #resize() {
    const density = window.devicePixelRatio;
    this.#canvas.width = Math.round(this.#canvas.clientWidth * density);
    this.#canvas.height = Math.round(this.#canvas.clientHeight * density);
    this.#draw();
  }

  /** CSS pixels per image pixel. @param {Snapshot} snapshot */
  #zoom(snapshot) {
    return this.#canvas.clientWidth / snapshot.camera.width_px;
  }

  /** An image pixel's centre has whole coordinates. @param {Pair} image_px @param {number} zoom @returns {Pair} */
  #onScreen([x, y], zoom) {
    return [(x + 0.5) * zoom, (y + 0.5) * zoom];
  }

  /** @param {CriticalArea} area @param {Scene} scene @returns {{at: Pair, radius: number}} */
  #place(area, { snapshot }) {
    const zoom = this.#zoom(snapshot);
    const { image_from_vessel, um_per_px } = snapshot.calibration;
    const at = this.#onScreen(apply(image_from_vessel, [area.center.x_px, area.center.y_px]), zoom);
    return { at, radius: (area.epsilon_um / um_per_px) * scaleOf(image_from_vessel) * zoom };
  }

  /** @param {Pair} css @param {Scene} scene */
  #areaAt([x, y], scene) {
    return scene.areas.find((area) => {
      const { at, radius } = this.#place(area, scene);
      return Math.hypot(at[0] - x, at[1] - y) <= Math.max(radius, 16);
    });
  }

  /** @param {PointerEvent | null} event */
  #hover(event) {
    this.#pointer = event && [event.offsetX, event.offsetY];
    this.#request();
  }

  /** @param {Pair} css */
  #click(css) {
    const scene = this.#scene;
    if (!scene) return;
    const area = this.#areaAt(css, scene);
    if (area) {
      this.#onChoose(area.id);
    } else if (scene.mayMark) {
      const zoom = this.#zoom(scene.snapshot);
      this.#onMark([css[0] / zoom - 0.5, css[1] / zoom - 0.5]);
    }
  }

  #draw() {
    const context = this.#context;
    const density = window.devicePixelRatio;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, this.#canvas.width, this.#canvas.height);
    const scene = this.#scene;
    if (!scene) return;
    context.setTransform(density, 0, 0, density, 0, 0);
    const { snapshot, state } = scene;
    const { image_from_vessel, um_per_px } = snapshot.calibration;
    const zoom = this.#zoom(snapshot);
    const css_per_um = (scaleOf(image_from_vessel) * zoom) / um_per_px;

    outline(context, scene.outline_px.map((line) => line.map((point) => this.#onScreen(point, zoom))));
    for (const area of scene.areas) {
      const { at, radius } = this.#place(area, scene);
      const is = { chosen: area.id === scene.chosen, active: area.id === state.critical_area };
      criticalArea(context, at, radius, area.label || area.id, is);
    }
    pathLine(context, state.path.map((point) => this.#onScreen(apply(image_from_vessel, point), zoom)));
    if (state.robot_px) {
      const radius = snapshot.vessel.robot_radius_um * css_per_um;
      robotRing(context, this.#onScreen(state.robot_px, zoom), radius, state.track.state === "tracking");
    }
    if (state.tip_seen_px) tipSeen(context, this.#onScreen(state.tip_seen_px, zoom));
    if (state.tip_px) tipCross(context, this.#onScreen(state.tip_px, zoom));
    scaleBar(context, SCALE_BAR_UM * css_per_um, `${SCALE_BAR_UM / 1000} mm`, this.#canvas.clientHeight);
    this.#drawPointer(scene, css_per_um);
  }

  /** @param {Scene} scene @param {number} css_per_um */
  #drawPointer(scene, css_per_um) {
    const pointer = this.#pointer;
    const over = pointer && this.#areaAt(pointer, scene);
    this.#canvas.style.cursor = over ? "pointer" : scene.mayMark ? "crosshair" : "default";
    if (!pointer || over || !scene.mayMark) return;
    const radius = scene.newEpsilon_um * css_per_um;
    this.#context.globalAlpha = 0.6;
    criticalArea(this.#context, pointer, radius, "", { chosen: false, active: false });
    this.#context.globalAlpha = 1;
    tag(this.#context, [pointer[0], pointer[1] - radius - 8], "Mark a critical area");
  }
}

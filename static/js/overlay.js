/**
 * What is drawn over the microscope's picture.
 * @module
 */

import { apply, scaleOf } from "./geometry.js";
import { clutchLine, criticalArea, outline, pathLine, robotRing, scaleBar, tag, tipCross, tipSeen } from "./marks.js";

/** @import { CriticalArea, Pair, Snapshot, State } from "./types.js" */
/** @import { Gestures } from "./gestures.js" */
/** @import { Tool } from "./tools.js" */
/** @import { Viewport } from "./viewport.js" */

const SCALE_BARS_UM = [2000, 1000, 500, 200, 100];
const LONGEST_BAR_CSS = 140;

/**
 * @typedef {object} Scene
 * @property {Snapshot} snapshot
 * @property {State} state
 * @property {CriticalArea[]} areas
 * @property {string | null} chosen Id of the area that Auto would go to.
 * @property {number} newEpsilon_um Radius of an area marked now.
 * @property {Pair[][]} outline_px The vessel model's walls in the image; none while nobody registers.
 * @property {boolean} mayMark Whether areas can be marked and changed here.
 * @property {Tool} tool
 * @property {boolean} mayDrive Whether this page is the rig's hand.
 */

export class Overlay {
  #canvas;
  #context;
  #viewport;
  #gestures;
  /** @type {Scene | null} */ #scene = null;
  #pending = false;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Viewport} viewport
   * @param {() => Gestures} gestures
   */
  constructor(canvas, viewport, gestures) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    this.#viewport = viewport;
    this.#gestures = gestures;
    new ResizeObserver(() => this.#resize()).observe(canvas);
  }

  /** The newest scene. */
  get scene() {
    return this.#scene;
  }

  /** Draw this scene at the next repaint. @param {Scene} scene */
  show(scene) {
    this.#scene = scene;
    this.request();
  }

  /** Draw at the next repaint. */
  request() {
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
    this.#viewport.resize(this.#canvas.clientWidth);
    this.#draw();
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
    const css_per_um = (scaleOf(image_from_vessel) * this.#viewport.css_per_px) / um_per_px;
    /** @param {Pair} image_px */
    const at = (image_px) => this.#viewport.toScreen(image_px);
    const { draft, pointer, steeringFrom } = this.#gestures();

    outline(context, scene.outline_px.map((line) => line.map(at)));
    for (const area of scene.areas) {
      if (area.id === draft?.id) continue;
      const center = at(apply(image_from_vessel, [area.center.x_px, area.center.y_px]));
      const is = { chosen: area.id === scene.chosen, active: area.id === state.critical_area };
      criticalArea(context, center, area.epsilon_um * css_per_um, area.label || area.id, is);
    }
    if (draft) {
      const is = { chosen: true, active: false };
      criticalArea(context, at(draft.image_px), draft.epsilon_um * css_per_um, `ε ${draft.epsilon_um} µm`, is);
    }
    pathLine(context, state.path.map((point) => at(apply(image_from_vessel, point))));
    if (state.robot_px) {
      const radius = snapshot.vessel.robot_radius_um * css_per_um;
      robotRing(context, at(state.robot_px), radius, state.track.state === "tracking");
    }
    if (state.tip_seen_px) tipSeen(context, at(state.tip_seen_px));
    if (state.tip_px) tipCross(context, at(state.tip_px));
    this.#drawScaleBar(css_per_um);
    if (steeringFrom && pointer) clutchLine(context, steeringFrom, pointer);
    else this.#drawPointer(scene, pointer, css_per_um);
  }

  /** @param {number} css_per_um */
  #drawScaleBar(css_per_um) {
    const fits = SCALE_BARS_UM.find((bar_um) => bar_um * css_per_um <= LONGEST_BAR_CSS) ?? 100;
    const text = fits >= 1000 ? `${fits / 1000} mm` : `${fits} µm`;
    scaleBar(this.#context, fits * css_per_um, text, this.#canvas.clientHeight);
  }

  /** @param {Scene} scene @param {Pair | null} pointer @param {number} css_per_um */
  #drawPointer(scene, pointer, css_per_um) {
    const gestures = this.#gestures();
    const over = pointer && scene.tool === "mark" && gestures.areaAt(pointer, scene);
    const cursors = { mark: scene.mayMark ? "crosshair" : "default", steer: scene.mayDrive ? "grab" : "default", pan: "move" };
    this.#canvas.style.cursor = over ? "pointer" : cursors[scene.tool];
    if (!pointer || over || gestures.draft || scene.tool !== "mark" || !scene.mayMark) return;
    const radius = scene.newEpsilon_um * css_per_um;
    this.#context.globalAlpha = 0.6;
    criticalArea(this.#context, pointer, radius, "", { chosen: false, active: false });
    this.#context.globalAlpha = 1;
    tag(this.#context, [pointer[0], pointer[1] - radius - 8], "Mark a critical area");
  }
}

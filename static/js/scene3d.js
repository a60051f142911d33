/**
 * The twin in three dimensions, to be looked at from above or from aside.
 * @module
 */

import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RigModel } from "./rig-model.js";

/** @import { Snapshot, State } from "./types.js" */
/** @typedef {"microscope" | "orbit"} View */

const FOV_DEG = 30;
const FRAME_MS = 1000 / 30;

export class Scene3d {
  #renderer;
  #scene = new three.Scene();
  #camera = new three.PerspectiveCamera(FOV_DEG, 4 / 3, 1e-3, 1);
  #controls;
  #rig = new RigModel();
  #canvas;
  /** @type {string | null} */ #vessel = null;
  /** @type {View} */ #view = "orbit";
  #pending = false;
  #visible = true;
  #drawn_ms = -Infinity;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.#canvas = canvas;
    this.#renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.#scene.add(new three.HemisphereLight(0xdfe8f0, 0x20262c, 0.9));
    const lamp = new three.DirectionalLight(0xffffff, 1.5);
    lamp.position.set(0.04, 0.05, -0.03);
    this.#scene.add(lamp, this.#rig.group);
    this.#controls = new OrbitControls(this.#camera, canvas);
    this.#controls.addEventListener("change", () => this.#draw());
    this.#controls.listenToKeyEvents(canvas);
    canvas.addEventListener("keydown", (event) => this.#zoom(event));
    new ResizeObserver(() => this.#resize()).observe(canvas);
    new IntersectionObserver(([entry]) => {
      this.#visible = entry?.isIntersecting ?? true;
      this.#draw();
    }).observe(canvas);
  }

  /**
   * Fetch the scene anew: at the start, and when areas or calibration changed.
   * @param {Snapshot} snapshot
   */
  async load(snapshot) {
    const first = this.#vessel !== snapshot.vessel.name;
    await this.#rig.load(snapshot);
    this.#vessel = snapshot.vessel.name;
    if (first) this.look(this.#view);
    this.#canvas.dataset.state = "ready";
    this.#draw();
  }

  /** Look from straight above, as the microscope does, or from aside. @param {View} view */
  look(view) {
    this.#view = view;
    if (this.#vessel === null) return;
    const { side_m } = this.#rig;
    const middle = side_m / 2;
    this.#controls.enableRotate = view === "orbit";
    this.#controls.target.set(middle, 0, middle);
    if (view === "microscope") {
      const away_m = (1.06 * middle) / Math.tan((FOV_DEG / 2) * (Math.PI / 180));
      // Not quite straight: a look along the up direction has no sideways.
      this.#camera.position.set(middle, away_m, middle + 1e-6);
    } else {
      this.#camera.position.set(middle + 0.45 * side_m, 1.5 * side_m, middle + 1.7 * side_m);
      this.#controls.target.set(middle, 0.18 * side_m, middle);
    }
    // From above the tool hides what it points at.
    this.#rig.showParts(["needle", "arm"], view !== "microscope");
    this.#controls.update();
    this.#draw();
  }

  /** @param {State} state */
  show(state) {
    this.#rig.show(state);
    this.#draw();
  }

  /** @param {KeyboardEvent} event */
  #zoom(event) {
    const by = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key];
    if (by === undefined) return;
    this.#camera.position.sub(this.#controls.target).multiplyScalar(by).add(this.#controls.target);
    this.#controls.update();
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width === 0 || height === 0) return;
    this.#renderer.setSize(width, height, false);
    this.#camera.aspect = width / height;
    this.#camera.updateProjectionMatrix();
    this.#draw();
  }

  /** Draw at the next repaint, but not more often than pictures come, and only while somebody can see it. */
  #draw() {
    if (this.#pending || !this.#visible) return;
    this.#pending = true;
    const wait_ms = Math.max(0, this.#drawn_ms + FRAME_MS - performance.now());
    setTimeout(() => requestAnimationFrame(() => this.#render()), wait_ms);
  }

  #render() {
    this.#pending = false;
    this.#drawn_ms = performance.now();
    this.#renderer.render(this.#scene, this.#camera);
  }
}

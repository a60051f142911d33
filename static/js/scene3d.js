/**
 * The twin in three dimensions: the rig's own scene, moved by the twin stream.
 *
 * The scene is in metres; x and z are the vessel's grid, y is the height over its floor.
 * @module
 */

import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** @import { Snapshot, State } from "./types.js" */
/** @typedef {"microscope" | "orbit"} View */

const SCENE = "/api/v1/vessel.glb";
const FOV_DEG = 30;
const UM = 1e-6;
const FRAME_MS = 1000 / 30;

export class Scene3d {
  #renderer;
  #scene = new three.Scene();
  #camera = new three.PerspectiveCamera(FOV_DEG, 4 / 3, 1e-3, 1);
  #controls;
  #loader = new GLTFLoader();
  #canvas;
  /** @type {three.Object3D | null} */ #rig = null;
  /** @type {three.Object3D | null} */ #robot = null;
  /** @type {three.Object3D | null} */ #tool = null;
  /** @type {Snapshot | null} */ #snapshot = null;
  #path = new three.Line(
    new three.BufferGeometry(),
    new three.LineBasicMaterial({ color: 0xf0e442, depthTest: false, transparent: true }),
  );
  /** @type {View} */ #view = "orbit";
  #pending = false;
  #visible = true;
  #drawn_ms = -Infinity;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.#canvas = canvas;
    this.#renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.#scene.add(new three.HemisphereLight(0xdfe8f0, 0x20262c, 1.6));
    const lamp = new three.DirectionalLight(0xffffff, 2.2);
    lamp.position.set(0.01, 0.05, -0.02);
    this.#scene.add(lamp, this.#path);
    this.#path.renderOrder = 2;
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
    const first = this.#snapshot?.vessel.name !== snapshot.vessel.name;
    this.#snapshot = snapshot;
    const { scene } = await this.#loader.loadAsync(SCENE);
    if (this.#rig) this.#scene.remove(this.#rig);
    this.#rig = scene;
    this.#scene.add(scene);
    this.#robot = scene.getObjectByName("robot") ?? null;
    this.#tool = scene.getObjectByName("tool") ?? null;
    if (first) this.look(this.#view);
    this.#canvas.dataset.state = "ready";
    this.#draw();
  }

  /** Look from straight above, as the microscope does, or from aside. @param {View} view */
  look(view) {
    this.#view = view;
    if (!this.#snapshot) return;
    const { size_px, um_per_px } = this.#snapshot.vessel;
    const side_m = size_px * um_per_px * UM;
    const middle = side_m / 2;
    this.#controls.enableRotate = view === "orbit";
    this.#controls.target.set(middle, 0, middle);
    if (view === "microscope") {
      const away_m = (1.06 * middle) / Math.tan((FOV_DEG / 2) * (Math.PI / 180));
      // Not quite straight: a look along the up direction has no sideways.
      this.#camera.position.set(middle, away_m, middle + 1e-6);
    } else {
      this.#camera.position.set(middle + 0.55 * side_m, 1.75 * side_m, middle + 2.1 * side_m);
      this.#controls.target.set(middle, 0.25 * side_m, middle);
    }
    // From above the tool hides what it points at.
    this.#showTool(view !== "microscope");
    this.#controls.update();
    this.#draw();
  }

  /** @param {State} state */
  show(state) {
    if (!this.#snapshot || !this.#robot || !this.#tool) return;
    const scale = this.#snapshot.vessel.um_per_px * UM;
    const { robot_vessel_px: robot, tip_um: tip } = state;
    this.#robot.visible = robot !== null;
    if (robot) {
      this.#robot.position.set(robot[0] * scale, this.#snapshot.vessel.robot_radius_um * UM, robot[1] * scale);
    }
    if (tip) {
      const { stage_from_vessel, floor_z_um } = this.#snapshot.calibration;
      const [[a, b, tx], [c, d, ty]] = stage_from_vessel;
      const [x, y] = [tip[0] - tx, tip[1] - ty];
      const by = scale / (a * d - b * c);
      // The floor's height is that of the robot's centre.
      const up_m = (tip[2] - floor_z_um + this.#snapshot.vessel.robot_radius_um) * UM;
      this.#tool.position.set((d * x - b * y) * by, up_m, (a * y - c * x) * by);
    }
    const height_m = this.#snapshot.vessel.robot_radius_um * UM;
    this.#path.geometry.setFromPoints(
      state.path.map(([x, y]) => new three.Vector3(x * scale, height_m, y * scale)),
    );
    this.#draw();
  }

  /** @param {boolean} visible */
  #showTool(visible) {
    for (const name of ["needle", "arm"]) {
      const part = this.#rig?.getObjectByName(name);
      if (part) part.visible = visible;
    }
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

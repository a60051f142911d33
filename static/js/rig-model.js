/**
 * The rig as an object of three.js: the server's own scene, moved by the twin stream.
 *
 * In metres; x and z are the vessel's grid, y is the height over its floor.
 * @module
 */

import * as three from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

/** @import { Snapshot, State } from "./types.js" */

const SCENE = "/api/v1/vessel.glb";
const UM = 1e-6;
/** Parts with edges: shading that runs around an edge makes a block look like a cushion. */
const FLAT = ["vessel", "plate"];

export class RigModel {
  group = new three.Group();
  #loader = new GLTFLoader();
  /** @type {three.Object3D | null} */ #rig = null;
  /** @type {three.Object3D | null} */ #robot = null;
  /** @type {three.Object3D | null} */ #tool = null;
  /** @type {Snapshot | null} */ #snapshot = null;
  /** @type {Set<string>} */ #hidden = new Set();
  #path = new three.Line(
    new three.BufferGeometry(),
    new three.LineBasicMaterial({ color: 0xf0e442, depthTest: false, transparent: true }),
  );

  constructor() {
    this.#path.renderOrder = 2;
    // Its points change all the time: the sphere around them would be that of the first ones.
    this.#path.frustumCulled = false;
    this.group.add(this.#path);
  }

  /** Side of the vessel model. */
  get side_m() {
    return this.#snapshot ? this.#snapshot.vessel.size_px * this.#snapshot.vessel.um_per_px * UM : 0;
  }

  /**
   * Fetch the scene anew: at the start, and when areas or calibration changed.
   * @param {Snapshot} snapshot
   */
  async load(snapshot) {
    this.#snapshot = snapshot;
    const { scene } = await this.#loader.loadAsync(SCENE);
    if (this.#rig) this.group.remove(this.#rig);
    this.#rig = scene;
    for (const name of FLAT) scene.getObjectByName(name)?.traverse(flatten);
    this.group.add(scene);
    this.#robot = scene.getObjectByName("robot") ?? null;
    this.#tool = scene.getObjectByName("tool") ?? null;
    this.showParts([...this.#hidden], false);
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
  }

  /** Show or hide parts of the tool. @param {string[]} names @param {boolean} visible */
  showParts(names, visible) {
    for (const name of names) {
      if (visible) this.#hidden.delete(name);
      else this.#hidden.add(name);
      const part = this.#rig?.getObjectByName(name);
      if (part) part.visible = visible;
    }
  }
}

/** @param {three.Object3D} part */
function flatten(part) {
  if (!(part instanceof three.Mesh) || !(part.material instanceof three.MeshStandardMaterial)) return;
  part.material.flatShading = true;
}

/**
 * What stands in the room: the twin on the table, the microscope behind it, what is read on its left and the
 * buttons on its right.
 * @module
 */

/// <reference types="webxr" />

import * as three from "three";
import { RigModel } from "../rig-model.js";
import { Hud } from "./hud.js";
import { Menu } from "./menu.js";
import { Microscope } from "./microscope.js";

/** @import { Snapshot, State, Triple, VesselPoint } from "../types.js" */
/** @import { Command } from "./menu.js" */

/** The table lies so far below the eyes, and the twin's middle so far before them. */
const BELOW_M = 0.38;
const AHEAD_M = 0.66;
const TOUCH_M = 0.015;
const OPEN = 0xe8ebee;
const CLOSED = 0xcc79a7;

/**
 * What a ray meets.
 * @typedef {{kind: "button", command: Command | null, point: three.Vector3} |
 *   {kind: "vessel", at: VesselPoint, point: three.Vector3} |
 *   {kind: "image", at: [number, number], point: three.Vector3}} Hit
 */

export class Cockpit {
  scene = new three.Scene();
  hud = new Hud();
  menu;
  microscope = new Microscope();
  rig = new RigModel();
  #group = new three.Group();
  #twin = new three.Group();
  #cursor = ring(0x009e73);
  #dot = new three.Mesh(
    new three.SphereGeometry(0.004, 16, 12),
    new three.MeshBasicMaterial({ color: 0xffffff, toneMapped: false }),
  );
  #hand = new three.Mesh(
    new three.SphereGeometry(0.007, 24, 16),
    new three.MeshBasicMaterial({ color: OPEN, transparent: true, toneMapped: false }),
  );
  #way = new three.Line(
    new three.BufferGeometry(),
    new three.LineBasicMaterial({ color: CLOSED, toneMapped: false }),
  );
  /** Where the clutch closed. @type {three.Vector3 | null} */ #from = null;
  #room = floor();
  #ray = new three.Raycaster();
  #yaw = 0;
  #scale = 1;
  placed = false;

  /** @param {(command: Command) => void} onPress */
  constructor(onPress) {
    this.menu = new Menu(onPress);
    this.scene.add(new three.HemisphereLight(0xdfe8f0, 0x30383f, 0.9));
    const lamp = new three.DirectionalLight(0xffffff, 1.5);
    lamp.position.set(0.6, 1.6, 0.4);
    this.#twin.add(this.rig.group);
    // The arm would reach over the operator's head.
    this.rig.showParts(["arm"], false);
    this.#group.add(lamp, lamp.target, this.#twin, this.#cursor, this.#hand, this.#way, ground());
    this.#way.frustumCulled = this.#hand.visible = false;
    set(this.microscope.mesh, [0, 0.27, -0.38], -0.12, 0);
    set(this.hud.mesh, [-0.48, 0.27, -0.26], -0.12, 0.5);
    set(this.menu.mesh, [0.48, 0.27, -0.26], -0.12, -0.5);
    this.#group.add(this.microscope.mesh, this.hud.mesh, this.menu.mesh);
    this.scene.add(this.#group, this.#dot, this.#room);
    this.#cursor.visible = this.#dot.visible = false;
  }

  /** Show a dark room, for a headset through which the bench is not seen. @param {boolean} closed */
  closeRoom(closed) {
    this.#room.visible = closed;
    this.scene.background = closed ? new three.Color(0x131619) : null;
  }

  /** @param {number} scale Metres in the room for a metre of the rig. */
  size(scale) {
    this.#scale = scale;
    const half = (this.rig.side_m * scale) / 2;
    this.#twin.scale.setScalar(scale);
    this.#twin.position.set(-half, 0, -half);
  }

  /**
   * Fetch the scene of this rig, areas included.
   * @param {Snapshot} snapshot
   * @param {number} scale
   */
  async load(snapshot, scale) {
    await this.rig.load(snapshot);
    this.size(scale);
  }

  /** Put the table before whoever looks. @param {XRRigidTransform} viewer */
  place({ position, matrix }) {
    // The way the head faces, on the level: third column of its matrix, backwards.
    this.#yaw = Math.atan2(matrix[8] ?? 0, matrix[10] ?? 1);
    this.#group.rotation.y = this.#yaw;
    this.#group.position
      .set(0, -BELOW_M, -AHEAD_M)
      .applyAxisAngle(new three.Vector3(0, 1, 0), this.#yaw)
      .add(new three.Vector3(position.x, position.y, position.z));
    this.#room.position.set(position.x, position.y - 1.2, position.z);
    this.placed = true;
  }

  /**
   * A place of the room along the table's axes: right, up, towards the operator.
   * @param {Triple} place_m
   * @returns {Triple}
   */
  alongTable([x, y, z]) {
    const [c, s] = [Math.cos(this.#yaw), Math.sin(this.#yaw)];
    return [c * x - s * z, y, s * x + c * z];
  }

  /**
   * Show what the rig takes for the hand, and how far it went since the clutch closed.
   * @param {Triple | null} place_m Along the table's axes.
   * @param {boolean} clutch
   */
  showHand(place_m, clutch) {
    this.#hand.visible = place_m !== null;
    this.#way.visible = place_m !== null && clutch;
    if (!place_m || !clutch) this.#from = null;
    if (!place_m) return;
    const up = new three.Vector3(0, 1, 0);
    const origin = this.#group.position.clone().applyAxisAngle(up, -this.#yaw);
    const at = new three.Vector3(...place_m).sub(origin);
    this.#hand.position.copy(at);
    this.#hand.material.color.set(clutch ? CLOSED : OPEN);
    this.#hand.material.opacity = clutch ? 1 : 0.55;
    if (!clutch) return;
    this.#from ??= at;
    this.#way.geometry.setFromPoints([this.#from, at]);
  }

  /**
   * What a ray meets first.
   * @param {XRRigidTransform} ray
   * @param {Snapshot | null} snapshot
   * @returns {Hit | null}
   */
  hit({ position, matrix }, snapshot) {
    this.#group.updateMatrixWorld();
    this.#ray.ray.origin.set(position.x, position.y, position.z);
    this.#ray.ray.direction.set(-(matrix[8] ?? 0), -(matrix[9] ?? 0), -(matrix[10] ?? 1)).normalize();
    const panels = [this.menu.mesh, this.microscope.mesh];
    const [met] = this.#ray.intersectObjects(panels, false);
    if (met?.uv) {
      if (met.object === this.menu.mesh) return { kind: "button", command: this.menu.at(met.uv), point: met.point };
      if (snapshot) return { kind: "image", at: this.microscope.imagePoint(met.uv, snapshot), point: met.point };
    }
    return snapshot ? this.#vesselHit(snapshot) : null;
  }

  /** Which button a fingertip touches. @param {Triple} place_m @returns {Command | null} */
  touched([x, y, z]) {
    this.#group.updateMatrixWorld();
    const at = this.menu.mesh.worldToLocal(new three.Vector3(x, y, z));
    if (Math.abs(at.z) > TOUCH_M) return null;
    const uv = { x: at.x / 0.34 + 0.5, y: at.y / 0.42 + 0.5 };
    return uv.x >= 0 && uv.x <= 1 && uv.y >= 0 && uv.y <= 1 ? this.menu.at(uv) : null;
  }

  /**
   * Show where the operator points.
   * @param {Hit | null} hit
   * @param {number | null} epsilon_m Radius of the area that would be marked; null while none would.
   */
  point(hit, epsilon_m) {
    this.menu.point(hit?.kind === "button" ? hit.command : null);
    this.#dot.visible = hit?.kind === "button" || (hit?.kind === "image" && epsilon_m !== null);
    if (hit && this.#dot.visible) this.#dot.position.copy(hit.point);
    this.#cursor.visible = hit?.kind === "vessel" && epsilon_m !== null;
    if (hit && this.#cursor.visible && epsilon_m !== null) {
      this.#cursor.position.copy(this.#group.worldToLocal(hit.point.clone()));
      this.#cursor.scale.setScalar(epsilon_m * this.#scale);
    }
  }

  /** @param {State} state */
  show(state) {
    this.rig.show(state);
  }

  /** @param {Snapshot} snapshot @returns {Hit | null} */
  #vesselHit({ vessel }) {
    const up = new three.Vector3(0, 1, 0);
    const table = new three.Plane().setFromNormalAndCoplanarPoint(up, this.#group.position);
    const point = this.#ray.ray.intersectPlane(table, new three.Vector3());
    if (!point) return null;
    const at = this.#twin.worldToLocal(point.clone()).divideScalar(vessel.um_per_px * 1e-6);
    const inside = at.x >= 0 && at.z >= 0 && at.x <= vessel.size_px && at.z <= vessel.size_px;
    return inside ? { kind: "vessel", at: { x_px: at.x, y_px: at.z }, point } : null;
  }
}

/** @param {three.Object3D} mesh @param {Triple} at @param {number} tilt @param {number} turn */
function set(mesh, at, tilt, turn) {
  mesh.position.set(...at);
  mesh.rotation.set(tilt, turn, 0, "YXZ");
}

/** @param {number} color */
function ring(color) {
  const mesh = new three.Mesh(
    new three.RingGeometry(0.86, 1, 48).rotateX(-Math.PI / 2),
    new three.MeshBasicMaterial({ color, toneMapped: false, depthTest: false, transparent: true }),
  );
  mesh.renderOrder = 3;
  return mesh;
}

/** A soft shadow under the twin, so that it stands somewhere. */
function ground() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 256;
  const context = canvas.getContext("2d");
  const fade = context?.createRadialGradient(128, 128, 40, 128, 128, 128);
  if (context && fade) {
    fade.addColorStop(0, "rgb(12 14 16 / 70%)");
    fade.addColorStop(1, "rgb(12 14 16 / 0%)");
    context.fillStyle = fade;
    context.fillRect(0, 0, 256, 256);
  }
  const mesh = new three.Mesh(
    new three.PlaneGeometry(1.1, 0.9).rotateX(-Math.PI / 2),
    new three.MeshBasicMaterial({ map: new three.CanvasTexture(canvas), transparent: true, depthWrite: false }),
  );
  mesh.position.y = -0.03;
  return mesh;
}

/** A floor to stand on where nothing of the real room is seen. */
function floor() {
  const grid = new three.GridHelper(6, 24, 0x3a424a, 0x252b31);
  grid.visible = false;
  return grid;
}

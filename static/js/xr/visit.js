/**
 * One visit with a headset: from entering to leaving, frame by frame.
 * @module
 */

/// <reference types="webxr" />

import { HandSource } from "./hand-source.js";

/** @import { WebGLRenderer } from "three" */
/** @import { Snapshot, Triple } from "../types.js" */
/** @import { Cockpit, Hit } from "./cockpit.js" */
/** @import { Command } from "./menu.js" */

/**
 * @typedef {object} VisitHandlers
 * @property {() => Snapshot | null} snapshot
 * @property {() => number | null} marking Radius of the area that a select marks, in metres; null: it marks none.
 * @property {(hit: Hit) => void} onMark
 * @property {(place_m: Triple | null, clutch: boolean, now_ms: number) => void} onHand
 * @property {(now_ms: number) => void} onFrame Before the frame is drawn.
 */

export class Visit {
  #session;
  #renderer;
  #cockpit;
  #handlers;
  #hand;
  #draw;
  /** @type {Command | null} */ #touched = null;

  /**
   * @param {XRSession} session Just begun.
   * @param {WebGLRenderer} renderer
   * @param {Cockpit} cockpit
   * @param {VisitHandlers} handlers
   * @param {boolean} draw False leaves the drawing out, for a machine that draws by software.
   */
  constructor(session, renderer, cockpit, handlers, draw) {
    this.#session = session;
    this.#renderer = renderer;
    this.#cockpit = cockpit;
    this.#handlers = handlers;
    this.#draw = draw;
    this.#hand = new HandSource(session, (source, frame) => this.#consumes(source, frame));
    cockpit.placed = false;
  }

  /** Begin. */
  async start() {
    // Before the session is set: three.js takes over the session's frames only for a loop that it knows.
    this.#renderer.setAnimationLoop((_, frame) => {
      if (frame) this.#onFrame(performance.now(), frame);
    });
    this.#renderer.xr.setReferenceSpaceType("local");
    await this.#renderer.xr.setSession(this.#session);
    // The headset's own button puts the origin elsewhere: everything jumps.
    this.#renderer.xr.getReferenceSpace()?.addEventListener("reset", () => {
      this.#hand.open();
      this.#cockpit.placed = false;
    });
  }

  /** Open the clutch: a new pinch closes it. */
  openClutch() {
    this.#hand.open();
  }

  /** Put the table before the operator with the next frame. */
  placeAnew() {
    this.#cockpit.placed = false;
  }

  /** Leave. */
  async end() {
    this.#renderer.setAnimationLoop(null);
    await this.#session.end().catch(() => undefined);
  }

  /** @param {number} now_ms @param {XRFrame} frame */
  #onFrame(now_ms, frame) {
    const space = this.#renderer.xr.getReferenceSpace();
    if (!space) return;
    const viewer = frame.getViewerPose(space);
    if (viewer && !this.#cockpit.placed) this.#cockpit.place(viewer.transform);
    const place = this.#cockpit.placed ? this.#hand.read(frame, space, now_ms) : null;
    this.#handlers.onHand(place && this.#cockpit.alongTable(place), this.#hand.clutch, now_ms);
    this.#point(frame, space, viewer, now_ms);
    this.#handlers.onFrame(now_ms);
    if (this.#draw) this.#renderer.render(this.#cockpit.scene, this.#renderer.xr.getCamera());
  }

  /**
   * @param {XRFrame} frame
   * @param {XRReferenceSpace} space
   * @param {XRViewerPose | undefined} viewer
   * @param {number} now_ms
   */
  #point(frame, space, viewer, now_ms) {
    /** @type {Hit | null} */ let hit = null;
    let pointing = false;
    for (const source of this.#hand.clutch ? [] : this.#session.inputSources) {
      const ray = frame.getPose(source.targetRaySpace, space)?.transform;
      if (!ray) continue;
      pointing = true;
      hit ??= this.#meant(this.#cockpit.hit(ray, this.#handlers.snapshot()));
      this.#touch(source, frame, space, now_ms);
    }
    const seesHand = pointing || this.#hand.clutch;
    const look = !seesHand && viewer ? this.#cockpit.hit(viewer.transform, null) : null;
    this.#cockpit.menu.look(look?.kind === "button" ? look.command : null, now_ms);
    this.#cockpit.point(hit ?? look, this.#handlers.marking());
  }

  /** What a ray meets, if a select there would do something. @param {Hit | null} hit @returns {Hit | null} */
  #meant(hit) {
    return hit?.kind === "button" || this.#handlers.marking() !== null ? hit : null;
  }

  /**
   * A finger presses a button by touching it; it must leave before it presses again.
   * @param {XRInputSource} source
   * @param {XRFrame} frame
   * @param {XRReferenceSpace} space
   * @param {number} now_ms
   */
  #touch(source, frame, space, now_ms) {
    const tip = source.hand?.get("index-finger-tip");
    const at = tip && frame.getJointPose?.(tip, space)?.transform.position;
    if (!at || source.handedness !== "right") return;
    const command = this.#cockpit.touched([at.x, at.y, at.z]);
    if (command !== null && command !== this.#touched) this.#cockpit.menu.press(command, now_ms);
    this.#touched = command;
  }

  /** @param {XRInputSource} source @param {XRFrame} frame @returns {boolean} */
  #consumes(source, frame) {
    const space = this.#renderer.xr.getReferenceSpace();
    const ray = space && frame.getPose(source.targetRaySpace, space)?.transform;
    if (!ray || this.#hand.clutch) return false;
    const hit = this.#meant(this.#cockpit.hit(ray, this.#handlers.snapshot()));
    if (hit?.kind === "button") {
      if (hit.command !== null) this.#cockpit.menu.press(hit.command, performance.now());
      return true;
    }
    if (hit) this.#handlers.onMark(hit);
    return hit !== null;
  }
}

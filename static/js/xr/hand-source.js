/**
 * The one hand, or controller, that steers: where it is, and whether it pinches.
 *
 * A pinch is the session's `select`: it needs no joints. Where joints are seen, the hand's place is the middle
 * between thumb and index finger, which stays where it is while the pinch opens.
 * @module
 */

/// <reference types="webxr" />

/** @import { Triple } from "../types.js" */

/** @typedef {"pinch" | "grip" | "ray"} Basis What the place is taken from. */
/** @typedef {{p: Triple, basis: Basis}} Place */

/** A hand that just came into view must be seen open before its pinch counts. */
const OPEN_FIRST_MS = 100;

export class HandSource {
  #session;
  #consumed;
  /** @type {XRHandedness | null} */ #steering = null;
  /** @type {XRInputSource | null} */ #closedBy = null;
  /** @type {Basis | null} */ #basis = null;
  #seen_ms = Infinity;

  /**
   * @param {XRSession} session
   * @param {(source: XRInputSource, frame: XRFrame) => boolean} consumed Tells whether a select was meant for
   *   something else, a button for example.
   */
  constructor(session, consumed) {
    this.#session = session;
    this.#consumed = consumed;
    session.addEventListener("selectstart", (event) => this.#onSelect(event));
    session.addEventListener("selectend", ({ inputSource }) => {
      if (inputSource === this.#closedBy) this.open();
    });
    session.addEventListener("inputsourceschange", ({ removed }) => {
      if (this.#closedBy !== null && removed.includes(this.#closedBy)) this.open();
    });
  }

  /** Whether the clutch is closed. */
  get clutch() {
    return this.#closedBy !== null;
  }

  /** Open the clutch: what was measured so far means nothing any more. */
  open() {
    this.#closedBy = null;
  }

  /**
   * Where the hand is; null while it is not seen, which opens the clutch.
   * @param {XRFrame} frame
   * @param {XRReferenceSpace} space
   * @param {number} now_ms
   * @returns {Triple | null}
   */
  read(frame, space, now_ms) {
    const place = this.#session.visibilityState === "visible" ? this.#find(frame, space) : null;
    // Another basis is another point of the hand: while the clutch is closed that would be a jump.
    if (place === null || (this.clutch && place.basis !== this.#basis)) {
      this.open();
      this.#seen_ms = Infinity;
      return null;
    }
    this.#basis = place.basis;
    this.#seen_ms = Math.min(this.#seen_ms, now_ms);
    return place.p;
  }

  /** @param {XRFrame} frame @param {XRReferenceSpace} space @returns {Place | null} */
  #find(frame, space) {
    const sources = [...this.#session.inputSources];
    if (this.#closedBy) return sources.includes(this.#closedBy) ? placeOf(this.#closedBy, frame, space) : null;
    if (this.#steering !== null) {
      const source = sources.find(({ handedness }) => handedness === this.#steering);
      return source ? placeOf(source, frame, space) : null;
    }
    sources.sort((a, b) => Number(b.handedness === "right") - Number(a.handedness === "right"));
    for (const source of sources) {
      const place = placeOf(source, frame, space);
      if (place) return place;
    }
    return null;
  }

  /** @param {XRInputSourceEvent} event */
  #onSelect({ inputSource, frame }) {
    if (this.#consumed(inputSource, frame) || this.clutch) return;
    const other = this.#steering !== null && this.#steering !== inputSource.handedness;
    this.#steering = inputSource.handedness;
    // The other hand takes over the steering with this pinch, and moves the magnet with the next one.
    if (other || performance.now() - this.#seen_ms < OPEN_FIRST_MS) return;
    this.#closedBy = inputSource;
  }
}

/**
 * @param {XRInputSource} source
 * @param {XRFrame} frame
 * @param {XRReferenceSpace} space
 * @returns {Place | null}
 */
function placeOf(source, frame, space) {
  if (source.targetRayMode !== "tracked-pointer") return null;
  const [thumb, index] = [source.hand?.get("thumb-tip"), source.hand?.get("index-finger-tip")];
  if (thumb && index) {
    const one = frame.getJointPose?.(thumb, space)?.transform.position;
    const other = frame.getJointPose?.(index, space)?.transform.position;
    if (one && other) {
      return { p: [(one.x + other.x) / 2, (one.y + other.y) / 2, (one.z + other.z) / 2], basis: "pinch" };
    }
  }
  for (const [basis, tracked] of /** @type {[Basis, XRSpace | undefined][]} */ ([
    ["grip", source.gripSpace],
    ["ray", source.targetRaySpace],
  ])) {
    const pose = tracked && frame.getPose(tracked, space);
    // An emulated position is a guess from a model of the arm.
    if (pose && !pose.emulatedPosition) {
      const { x, y, z } = pose.transform.position;
      return { p: [x, y, z], basis };
    }
  }
  return null;
}

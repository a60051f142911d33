/**
 * This page as the rig's hand: 60 messages a second while it is seen, through the same checks as a headset's.
 *
 * Pointer, keys and gamepad close the clutch and move it; whatever ends unexpectedly opens the clutch.
 * @module
 */

/** @import { HandLease, Pair, Triple } from "./types.js" */
/** @import { TwinClient } from "./twin.js" */

const PERIOD_MS = 1000 / 60;
const SHORTEST_MS = 14;
const FASTEST_M_PER_S = 1.2;
const LONGEST_S = 0.1;

/** @typedef {"pointer" | "keys" | "gamepad"} Source */

/**
 * @typedef {object} HandHandlers
 * @property {(dt_s: number) => void} onBeat Called before each message: what steers by time moves the hand.
 * @property {() => void} onChange The seat or the clutch changed.
 * @property {(why: string) => void} onLost The seat was lost or refused.
 */

export class PageHand {
  #twin;
  #handlers;
  #seated = false;
  #wanted = false;
  #gain = 0.04;
  #seq = 0;
  #pose = 0;
  #sent_ms = -Infinity;
  /** @type {Triple} */ #position_m = [0, 0, 0];
  /** @type {Pair} */ #pending_m = [0, 0];
  /** @type {Source | null} */ #holder = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #timer;

  /**
   * @param {TwinClient} twin
   * @param {HandHandlers} handlers
   */
  constructor(twin, handlers) {
    this.#twin = twin;
    this.#handlers = handlers;
    for (const name of ["blur", "pagehide", "freeze"]) addEventListener(name, () => this.open());
    document.addEventListener("visibilitychange", () => this.#onVisibility());
  }

  /** Whether this page is the rig's hand. */
  get seated() {
    return this.#seated;
  }

  /** Whether it is, or will be once the link is back. */
  get wanted() {
    return this.#wanted;
  }

  /** What holds the clutch closed; null while it is open. */
  get holder() {
    return this.#holder;
  }

  /** Sit down, now or as soon as the link is back. */
  take() {
    this.#wanted = true;
    this.#twin.takeHand("dashboard", "stage");
  }

  /** Get up. */
  give() {
    this.open();
    this.#wanted = false;
    this.#twin.giveHand();
  }

  /** The link is new: a seat that this page had is gone with the old one. */
  reconnected() {
    this.open();
    if (this.#wanted) this.take();
  }

  /** The link is lost: nothing that is steered now arrives. */
  disconnected() {
    this.open();
    this.#seated = false;
    this.#handlers.onChange();
  }

  /** @param {HandLease} lease */
  onLease(lease) {
    this.#seated = lease.lease;
    if (lease.transform) this.#gain = lease.transform.gain;
    if (!lease.lease) this.open();
    // A silent seat comes back by sending; what was displaced or refused does not.
    if (!lease.lease && lease.code !== "silent" && lease.code !== "given_back") {
      this.#wanted = false;
      this.#handlers.onLost(lease.message);
    }
    this.#handlers.onChange();
    if (this.#wanted) this.#schedule();
  }

  /** Close the clutch, unless something else holds it. @param {Source} source @returns {boolean} */
  close(source) {
    if (!this.#seated || document.hidden || (this.#holder !== null && this.#holder !== source)) return false;
    if (this.#holder === null) {
      this.#pending_m = [0, 0];
      this.#holder = source;
      this.#send();
      this.#handlers.onChange();
    }
    return true;
  }

  /** Open the clutch. @param {Source} [source] Only if this one holds it. */
  open(source) {
    if (this.#holder === null || (source !== undefined && this.#holder !== source)) return;
    this.#holder = null;
    this.#pending_m = [0, 0];
    this.#send();
    this.#handlers.onChange();
  }

  /**
   * Move the hand so that the tip follows at the coarse scale; at the fine scale it goes a part of the way.
   * @param {Pair} way_um On the stage.
   */
  move([x_um, y_um]) {
    if (this.#holder === null) return;
    const m_per_um = 1e-6 / this.#gain;
    this.#pending_m = [this.#pending_m[0] + x_um * m_per_um, this.#pending_m[1] + y_um * m_per_um];
    if (performance.now() - this.#sent_ms >= SHORTEST_MS) this.#send();
  }

  #beat() {
    if (!this.#wanted || document.hidden) return;
    const dt_s = Math.min((performance.now() - this.#sent_ms) / 1000, LONGEST_S);
    this.#handlers.onBeat(dt_s);
    // What steered by time may have sent already.
    if (performance.now() - this.#sent_ms >= SHORTEST_MS) this.#send();
    else this.#schedule();
  }

  #schedule() {
    clearTimeout(this.#timer);
    const left_ms = this.#sent_ms + PERIOD_MS - performance.now();
    this.#timer = setTimeout(() => this.#beat(), Math.max(left_ms, 0));
  }

  #send() {
    const now_ms = performance.now();
    this.#advance(Math.min((now_ms - this.#sent_ms) / 1000, LONGEST_S));
    // On the beat, so that waiting a little too long does not slow the stream down.
    this.#sent_ms = Math.max(now_ms - PERIOD_MS / 2, Math.min(this.#sent_ms + PERIOD_MS, now_ms));
    this.#twin.sendHand({
      type: "hand",
      seq: ++this.#seq,
      t: now_ms / 1000,
      p: this.#position_m,
      clutch: this.#holder !== null,
      valid: true,
      pose: this.#pose,
    });
    if (this.#wanted && !document.hidden) this.#schedule();
  }

  /**
   * A pointer may be thrown across the picture: no hand is that fast, and the rest of its way is left out.
   * @param {number} dt_s
   */
  #advance(dt_s) {
    const [x, y] = this.#pending_m;
    const way_m = Math.hypot(x, y);
    if (way_m === 0) return;
    const share = Math.min(1, (FASTEST_M_PER_S * Math.max(dt_s, PERIOD_MS / 2000)) / way_m);
    this.#position_m = [this.#position_m[0] + share * x, this.#position_m[1] + share * y, 0];
    this.#pending_m = [0, 0];
    this.#pose += 1;
  }

  /** A page that nobody sees steers nothing: it falls silent, and the rig holds. */
  #onVisibility() {
    if (document.hidden) {
      this.open();
      clearTimeout(this.#timer);
    } else if (this.#wanted) {
      this.#schedule();
    }
  }
}

/**
 * The hand's messages: 60 a second on absolute deadlines while it is seen, none while it is not.
 * @module
 */

/** @import { HandMessage, Triple } from "../types.js" */

const PERIOD_MS = 1000 / 60;
/** A place that is older is none: the headset was taken off, or its frames stopped. */
const STALE_MS = 100;

export class HandSender {
  #send;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #timer;
  #due_ms = 0;
  #seq = 0;
  #pose = 0;
  #taken_ms = -Infinity;
  /** @type {Triple} */ #place_m = [0, 0, 0];
  #clutch = false;
  #seen = false;
  #sending = false;
  /** How many were sent. */
  sent = 0;

  /** @param {(message: HandMessage) => boolean} send */
  constructor(send) {
    this.#send = send;
  }

  /** Send from now on. */
  start() {
    this.#due_ms = performance.now();
    this.#beat();
  }

  /** Send no more. */
  stop() {
    clearTimeout(this.#timer);
    this.lose();
  }

  /**
   * The hand is seen.
   * @param {Triple} place_m In WebXR's axes.
   * @param {boolean} clutch
   * @param {number} now_ms
   */
  see(place_m, clutch, now_ms) {
    this.#place_m = place_m;
    this.#clutch = clutch;
    this.#taken_ms = now_ms;
    this.#pose += 1;
    this.#seen = true;
  }

  /** The hand is not seen: one message says so, and then there is silence. */
  lose() {
    this.#seen = false;
    this.#clutch = false;
    if (this.#sending) this.#tell(false);
    this.#sending = false;
  }

  #beat() {
    const now_ms = performance.now();
    if (this.#seen && now_ms - this.#taken_ms > STALE_MS) this.lose();
    if (this.#seen) this.#tell(true);
    // After a pause there is nothing to catch up with.
    this.#due_ms = Math.max(this.#due_ms + PERIOD_MS, now_ms - PERIOD_MS);
    this.#timer = setTimeout(() => this.#beat(), Math.max(0, this.#due_ms - performance.now()));
  }

  /** @param {boolean} valid */
  #tell(valid) {
    const message = {
      type: /** @type {const} */ ("hand"),
      seq: ++this.#seq,
      t: this.#taken_ms / 1000,
      p: this.#place_m,
      clutch: this.#clutch,
      valid,
      pose: this.#pose,
    };
    this.#sending = valid;
    if (this.#send(message)) this.sent += 1;
  }
}

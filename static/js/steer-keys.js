/**
 * Steering by keys, for who has no pointer: arrow keys move the magnet, C closes the clutch without moving it.
 * @module
 */

/** @import { Pair } from "./types.js" */
/** @import { PageHand } from "./page-hand.js" */

const FASTEST_UM_PER_S = 2000;
const RISE_S = 0.35;

/** @type {Record<string, Pair>} */
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class SteerKeys {
  #hand;
  /** @type {Set<string>} */ #held = new Set();
  #speed_um_per_s = 0;

  /**
   * @param {HTMLElement} picture Must have the focus.
   * @param {PageHand} hand
   */
  constructor(picture, hand) {
    this.#hand = hand;
    picture.addEventListener("keydown", (event) => this.#press(event));
    picture.addEventListener("keyup", (event) => this.#lift(event.code));
    // A key that is let go elsewhere is never told: whoever looks away has let go.
    picture.addEventListener("blur", () => this.#liftAll());
    addEventListener("blur", () => this.#liftAll());
  }

  /** @param {number} dt_s */
  advance(dt_s) {
    const ways = [...this.#held].flatMap((code) => (WAYS[code] ? [WAYS[code]] : []));
    const x = ways.reduce((sum, way) => sum + way[0], 0);
    const y = ways.reduce((sum, way) => sum + way[1], 0);
    const length = Math.hypot(x, y);
    if (length === 0 || this.#hand.holder !== "keys") {
      this.#speed_um_per_s = 0;
      return;
    }
    // A tap is a small step, a held key gathers speed.
    const rise = (FASTEST_UM_PER_S * dt_s) / RISE_S;
    this.#speed_um_per_s = Math.min(this.#speed_um_per_s + rise, FASTEST_UM_PER_S);
    const step_um = (this.#speed_um_per_s * dt_s) / length;
    this.#hand.move([x * step_um, y * step_um]);
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (!(event.code in WAYS) && event.code !== "KeyC") return;
    if (!this.#hand.seated) return;
    event.preventDefault();
    if (event.repeat) return;
    this.#held.add(event.code);
    this.#hand.close("keys");
  }

  /** @param {string} code */
  #lift(code) {
    this.#held.delete(code);
    if (this.#held.size === 0) this.#hand.open("keys");
  }

  #liftAll() {
    this.#held.clear();
    this.#hand.open("keys");
  }
}

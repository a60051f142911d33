/**
 * Steering by gamepad: a trigger is the clutch, the left stick moves the magnet, B is STOP, Y changes the scale.
 * @module
 */

/** @import { PageHand } from "./page-hand.js" */

const FASTEST_UM_PER_S = 2500;
const DEAD = 0.15;
/** Of the standard layout. */
const TRIGGERS = [6, 7];
const STOP = 1;
const SCALE = 3;

export class SteerGamepad {
  #hand;
  #onStop;
  #onScale;
  #released = false;
  #pressed = new Set();

  /**
   * @param {PageHand} hand
   * @param {{onStop: () => void, onScale: () => void}} handlers
   */
  constructor(hand, { onStop, onScale }) {
    this.#hand = hand;
    this.#onStop = onStop;
    this.#onScale = onScale;
    addEventListener("gamepaddisconnected", () => hand.open("gamepad"));
  }

  /** Name of the pad in use; "" if there is none. */
  get name() {
    return this.#pad()?.id ?? "";
  }

  /** STOP works whenever the page is seen, whoever steers. */
  watch() {
    const pad = this.#pad();
    if (!pad) return;
    if (this.#newly(pad, STOP)) this.#onStop();
    if (this.#newly(pad, SCALE)) this.#onScale();
  }

  /** @param {number} dt_s */
  advance(dt_s) {
    const pad = this.#pad();
    const closed = pad !== null && TRIGGERS.some((button) => (pad.buttons[button]?.value ?? 0) > 0.5);
    if (!pad || !closed) {
      this.#released = pad !== null;
      this.#hand.open("gamepad");
      return;
    }
    // A trigger that was held before this page steered is no wish to steer.
    if (!this.#released || !this.#hand.close("gamepad")) return;
    const [x = 0, y = 0] = pad.axes;
    const tilt = Math.hypot(x, y);
    if (tilt < DEAD) return;
    const share = Math.min((tilt - DEAD) / (1 - DEAD), 1);
    const step_um = (share * share * FASTEST_UM_PER_S * dt_s) / tilt;
    this.#hand.move([x * step_um, y * step_um]);
  }

  /** @param {Gamepad} pad @param {number} button Whether it went down since the last look. */
  #newly(pad, button) {
    const down = pad.buttons[button]?.pressed ?? false;
    const newly = down && !this.#pressed.has(button);
    if (down) this.#pressed.add(button);
    else this.#pressed.delete(button);
    return newly;
  }

  /** @returns {Gamepad | null} */
  #pad() {
    return navigator.getGamepads?.().find((pad) => pad?.connected) ?? null;
  }
}

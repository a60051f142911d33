/**
 * STOP: from anybody, in any state, over every way to the server at once.
 *
 * The button is never disabled. Space (outside text fields) and Escape (everywhere) press it.
 * @module
 */

import { request } from "./api.js";
import { byId, setText } from "./dom.js";

/** @import { Answer } from "./types.js" */
/** @import { Messages } from "./messages.js" */

const RETRY_MS = 250;
const DOUBT_AFTER_MS = 1000;
const GIVE_UP_MS = 10_000;
const UNCONFIRMED =
  "STOP is not confirmed. Switch off the power of the manipulator's controller if anything moves.";

const TEXT_TYPES = new Set(["text", "number", "search", "email", "password", "tel", "url"]);

/** @param {EventTarget | null} target */
function isTextField(target) {
  if (target instanceof HTMLInputElement) return TEXT_TYPES.has(target.type);
  return target instanceof HTMLTextAreaElement || (target instanceof HTMLElement && target.isContentEditable);
}

export class StopButton {
  #button = byId("stop", HTMLButtonElement);
  #hint = byId("stop-hint", HTMLElement);
  #askTwin;
  #messages;
  #doubted = false;
  /** When the press that still waits for its confirmation came. @type {number | null} */ #pressed_ms = null;

  /**
   * @param {() => Promise<Answer>} askTwin Asks over the twin's link.
   * @param {Messages} messages
   */
  constructor(askTwin, messages) {
    this.#askTwin = askTwin;
    this.#messages = messages;
    this.#button.addEventListener("pointerdown", (event) => {
      if (event.button === 0) this.press();
    });
    this.#button.addEventListener("click", (event) => {
      // A click without a pointer: Enter, or a screen reader.
      if (event.detail === 0) this.press();
    });
    addEventListener("keydown", (event) => this.#key(event, true), { capture: true });
    addEventListener("keyup", (event) => this.#key(event, false), { capture: true });
  }

  /** Stop the rig, and repeat until the server confirms it. */
  press() {
    const waiting = this.#pressed_ms !== null;
    this.#pressed_ms = performance.now();
    this.#button.dataset.state = "sending";
    setText(this.#hint, "Sending…");
    if (waiting) this.#send();
    else this.#repeat();
  }

  /** The server says whether the rig is stopped. @param {boolean} stopped */
  confirm(stopped) {
    if (stopped) {
      this.#pressed_ms = null;
      if (this.#doubted) this.#messages.clear();
      this.#doubted = false;
    }
    if (this.#pressed_ms !== null) return;
    this.#button.dataset.state = stopped ? "stopped" : "ready";
    setText(this.#hint, stopped ? "Stopped" : "Space or Esc");
  }

  #repeat() {
    if (this.#pressed_ms === null) return;
    const waited_ms = performance.now() - this.#pressed_ms;
    if (waited_ms > DOUBT_AFTER_MS) {
      setText(this.#hint, "Not confirmed");
      this.#messages.say(UNCONFIRMED, "warning");
      this.#doubted = true;
    }
    if (waited_ms > GIVE_UP_MS) {
      this.#pressed_ms = null;
      this.#button.dataset.state = "ready";
      return;
    }
    this.#send();
    setTimeout(() => this.#repeat(), RETRY_MS);
  }

  #send() {
    const accepted = () => this.confirm(true);
    void this.#askTwin().then((answer) => {
      if (answer.ok) accepted();
    });
    request("POST", "/mode", { ask: "stop" }).then(accepted, () => undefined);
  }

  /** @param {KeyboardEvent} event @param {boolean} down */
  #key(event, down) {
    const isStop = event.key === "Escape" || (event.key === " " && !isTextField(event.target));
    if (!isStop || event.ctrlKey || event.altKey || event.metaKey || event.isComposing) return;
    // Space would also press whichever button has the focus: on keydown in some browsers, on keyup in others.
    event.preventDefault();
    event.stopPropagation();
    if (down && !event.repeat) this.press();
  }
}

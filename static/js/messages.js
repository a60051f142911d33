/**
 * The line below the picture: the server's refusals and the rig's events, newest first.
 * @module
 */

import { byId, setText } from "./dom.js";
import { sentence } from "./guide.js";

/** @typedef {"info" | "warning"} Tone */

const INFO_SHOWN_MS = 6000;

export class Messages {
  #bar = byId("message", HTMLElement);
  #text = byId("message-text", HTMLElement);
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #timer;

  constructor() {
    byId("message-dismiss", HTMLButtonElement).addEventListener("click", () => this.clear());
  }

  /**
   * Say something. A warning stays until it is dismissed or replaced.
   * @param {string} text
   * @param {Tone} tone
   */
  say(text, tone) {
    clearTimeout(this.#timer);
    this.#bar.dataset.tone = tone;
    setText(this.#text, sentence(text));
    if (tone === "info") this.#timer = setTimeout(() => this.clear(), INFO_SHOWN_MS);
  }

  /** Say nothing. */
  clear() {
    clearTimeout(this.#timer);
    this.#bar.dataset.tone = "none";
    setText(this.#text, "");
  }
}

/**
 * The line below the picture: answers to what the operator asked for, and what the rig reports by itself.
 * @module
 */

import { byId, setText } from "./dom.js";
import { sentence } from "./guide.js";

/** @typedef {"info" | "warning"} Tone */

const INFO_SHOWN_MS = 6000;
/** What the operator asked is answered for so long before what the rig reports may take its place. */
const ANSWER_SHOWN_MS = 6000;

export class Messages {
  #bar = byId("message", HTMLElement);
  #text = byId("message-text", HTMLElement);
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #timer;
  #answering = false;
  /** The newest report that an answer keeps waiting. @type {{text: string, tone: Tone} | null} */ #waiting = null;

  constructor() {
    byId("message-dismiss", HTMLButtonElement).addEventListener("click", () => this.clear());
  }

  /**
   * Say something that answers the operator. A warning stays until it is dismissed or replaced.
   * @param {string} text
   * @param {Tone} tone
   */
  say(text, tone) {
    this.#waiting = null;
    this.#put(text, tone);
    this.#answering = tone === "warning";
    if (this.#answering) this.#timer = setTimeout(() => this.#nextReport(), ANSWER_SHOWN_MS);
  }

  /**
   * Say what happened by itself; a refusal that was just given is read first.
   * @param {string} text
   * @param {Tone} tone
   */
  report(text, tone) {
    if (this.#answering) this.#waiting = { text, tone };
    else this.#put(text, tone);
  }

  /** Say nothing, or the report that waits. */
  clear() {
    clearTimeout(this.#timer);
    this.#bar.dataset.tone = "none";
    setText(this.#text, "");
    this.#nextReport();
  }

  #nextReport() {
    const next = this.#waiting;
    this.#answering = false;
    this.#waiting = null;
    if (next) this.#put(next.text, next.tone);
  }

  /** @param {string} text @param {Tone} tone */
  #put(text, tone) {
    clearTimeout(this.#timer);
    this.#bar.dataset.tone = tone;
    setText(this.#text, sentence(text));
    if (tone === "info") this.#timer = setTimeout(() => this.clear(), INFO_SHOWN_MS);
  }
}

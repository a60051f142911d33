/**
 * The fifteen pairs: one at a time, by pointer, by arrow keys, and back again.
 * @module
 */

import { byId, make, setText } from "./dom.js";

/** @typedef {{key: string, title: string, question: string, low: string, high: string}} Scale */
/** @typedef {{left: string, right: string, chosen: string}} Choice */

/** The choice is seen for so long before the next pair comes; it also takes care of double taps. */
const SEEN_MS = 220;

export class Pairs {
  #step = byId("step-pairs", HTMLElement);
  #count = byId("pair-count", HTMLElement);
  #progress = byId("progress", HTMLElement);
  #left = byId("left", HTMLButtonElement);
  #right = byId("right", HTMLButtonElement);
  #back = byId("pair-back", HTMLButtonElement);
  /** @type {Map<string, Scale>} */ #scales;
  #pairs;
  #onChange;
  #at = 0;
  #settling = false;
  /** @type {Choice[]} */ choices;

  /**
   * @param {Scale[]} scales
   * @param {[string, string][]} pairs Left and right.
   * @param {Choice[]} choices Those made before.
   * @param {{onChange: () => void, onDone: () => void}} handlers
   */
  constructor(scales, pairs, choices, { onChange, onDone }) {
    this.#scales = new Map(scales.map((scale) => [scale.key, scale]));
    this.#pairs = pairs;
    this.choices = choices.slice(0, pairs.length);
    this.#onChange = () => (this.choices.length === pairs.length && this.#at === pairs.length ? onDone() : onChange());
    this.#left.addEventListener("click", () => this.#choose(0));
    this.#right.addEventListener("click", () => this.#choose(1));
    this.#back.addEventListener("click", () => this.#goBack());
    document.addEventListener("keydown", (event) => this.#onKey(event));
    this.#progress.replaceChildren(...pairs.map(() => make("li")));
  }

  /** Show the first pair that is not judged yet, or the last one. */
  show() {
    this.#at = Math.min(this.choices.length, this.#pairs.length - 1);
    this.#draw();
  }

  /** @param {KeyboardEvent} event */
  #onKey(event) {
    if (this.#step.hidden || event.repeat || event.altKey || event.ctrlKey || event.metaKey) return;
    const does = { ArrowLeft: () => this.#choose(0), ArrowRight: () => this.#choose(1), Backspace: () => this.#goBack() };
    if (!(event.key in does)) return;
    event.preventDefault();
    does[/** @type {keyof typeof does} */ (event.key)]();
  }

  /** @param {0 | 1} side */
  #choose(side) {
    const pair = this.#pairs[this.#at];
    if (this.#settling || !pair) return;
    const [left, right] = pair;
    this.choices[this.#at] = { left, right, chosen: pair[side] };
    this.#settling = true;
    this.#draw();
    setTimeout(() => {
      this.#settling = false;
      this.#at += 1;
      this.#onChange();
      this.#draw();
    }, SEEN_MS);
  }

  #goBack() {
    if (this.#settling || this.#at === 0) return;
    this.#at -= 1;
    this.#draw();
  }

  #draw() {
    const pair = this.#pairs[this.#at];
    if (!pair) return;
    const chosen = this.choices[this.#at]?.chosen;
    [this.#left, this.#right].forEach((button, side) => {
      const key = pair[side];
      const scale = key === undefined ? undefined : this.#scales.get(key);
      const [title, question] = button.children;
      if (!scale || !title || !question) return;
      setText(title, scale.title);
      setText(question, scale.question);
      button.dataset.chosen = String(chosen === key);
    });
    setText(this.#count, `Pair ${this.#at + 1} of ${this.#pairs.length}`);
    this.#back.disabled = this.#at === 0;
    [...this.#progress.children].forEach((tick, i) => {
      tick.setAttribute("data-state", i === this.#at ? "now" : i < this.choices.length ? "done" : "open");
    });
  }
}

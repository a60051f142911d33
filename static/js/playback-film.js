/**
 * The trial's film in step with the time: one picture at a time, the newest wanted one next.
 * @module
 */

import { indexAt } from "./playback-time.js";

export class Film {
  #picture;
  #times_s;
  #url;
  #shown = -1;
  #wanted = -1;
  #loading = false;

  /** @param {HTMLImageElement} picture @param {string} trial @param {number[]} times_s */
  constructor(picture, trial, times_s) {
    this.#picture = picture;
    this.#times_s = times_s;
    this.#url = `/api/v1/trials/${encodeURIComponent(trial)}/film`;
    const done = () => {
      this.#loading = false;
      this.#load();
    };
    picture.addEventListener("load", done);
    picture.addEventListener("error", done);
  }

  /** @param {number} at_s */
  show(at_s) {
    this.#wanted = indexAt(this.#times_s, at_s);
    this.#load();
  }

  #load() {
    if (this.#loading || this.#wanted === this.#shown) return;
    this.#loading = true;
    this.#shown = this.#wanted;
    this.#picture.src = `${this.#url}/${this.#wanted}.jpg`;
  }
}

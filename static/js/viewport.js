/**
 * Which part of the microscope's picture is shown: zoom and pan.
 * @module
 */

/** @import { Pair } from "./types.js" */

const CLOSEST = 8;

export class Viewport {
  #onChange;
  #width_px = 1600;
  #height_px = 1200;
  #canvas_css = 800;
  /** Image pixel at the canvas's upper left corner. @type {Pair} */ #origin_px = [0, 0];
  scale = 1;

  /** @param {() => void} onChange */
  constructor(onChange) {
    this.#onChange = onChange;
  }

  /** @param {{width_px: number, height_px: number}} camera */
  useCamera({ width_px, height_px }) {
    this.#width_px = width_px;
    this.#height_px = height_px;
    this.#place(this.#origin_px);
  }

  /** @param {number} width_css Width of the canvas in CSS pixels. */
  resize(width_css) {
    this.#canvas_css = width_css;
    this.#onChange();
  }

  /** CSS pixels per image pixel. */
  get css_per_px() {
    return (this.#canvas_css / this.#width_px) * this.scale;
  }

  /** What moves and sizes the picture's own canvas. */
  get transform() {
    const [x, y] = this.#origin_px;
    return `translate(${-x * this.css_per_px}px, ${-y * this.css_per_px}px) scale(${this.scale})`;
  }

  /** An image pixel's centre has whole coordinates. @param {Pair} image_px @returns {Pair} */
  toScreen([x, y]) {
    return [(x + 0.5 - this.#origin_px[0]) * this.css_per_px, (y + 0.5 - this.#origin_px[1]) * this.css_per_px];
  }

  /** @param {Pair} css @returns {Pair} */
  toImage([x, y]) {
    return [x / this.css_per_px + this.#origin_px[0] - 0.5, y / this.css_per_px + this.#origin_px[1] - 0.5];
  }

  /**
   * Come closer or go away; what lies under a point stays there.
   * @param {number} factor
   * @param {Pair} [css] The canvas's middle if left out.
   */
  zoom(factor, css = [this.#canvas_css / 2, (this.#canvas_css * this.#height_px) / this.#width_px / 2]) {
    const [x, y] = this.toImage(css);
    this.scale = Math.min(Math.max(this.scale * factor, 1), CLOSEST);
    if (this.scale < 1.02) this.scale = 1;
    this.#place([x + 0.5 - css[0] / this.css_per_px, y + 0.5 - css[1] / this.css_per_px]);
  }

  /** Move the picture with a pointer. @param {Pair} css How far. */
  pan([dx, dy]) {
    const [x, y] = this.#origin_px;
    this.#place([x - dx / this.css_per_px, y - dy / this.css_per_px]);
  }

  /** Show the whole picture. */
  fit() {
    this.scale = 1;
    this.#place([0, 0]);
  }

  /** The picture always fills the canvas. @param {Pair} origin_px */
  #place([x, y]) {
    const hidden = 1 - 1 / this.scale;
    this.#origin_px = [
      Math.min(Math.max(x, 0), hidden * this.#width_px),
      Math.min(Math.max(y, 0), hidden * this.#height_px),
    ];
    this.#onChange();
  }
}

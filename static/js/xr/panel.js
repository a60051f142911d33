/**
 * A flat panel in the room that is painted like a picture.
 * @module
 */

import * as three from "three";

export class Panel {
  mesh;
  context;
  #texture;
  #key = "";

  /**
   * @param {number} width_m
   * @param {number} height_m
   * @param {HTMLCanvasElement} canvas Its size is the resolution.
   */
  constructor(width_m, height_m, canvas) {
    const context = canvas.getContext("2d");
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.context = context;
    this.#texture = new three.CanvasTexture(canvas);
    this.#texture.colorSpace = three.SRGBColorSpace;
    this.#texture.anisotropy = 4;
    this.mesh = new three.Mesh(
      new three.PlaneGeometry(width_m, height_m),
      new three.MeshBasicMaterial({ map: this.#texture, transparent: true, toneMapped: false }),
    );
  }

  /**
   * Paint anew if what it shows has changed.
   * @param {unknown} content All that the picture depends on.
   * @param {(context: CanvasRenderingContext2D, width: number, height: number) => void} paint
   */
  show(content, paint) {
    const key = JSON.stringify(content);
    if (key === this.#key) return;
    this.#key = key;
    this.repaint(paint);
  }

  /** @param {(context: CanvasRenderingContext2D, width: number, height: number) => void} paint */
  repaint(paint) {
    const { canvas } = this.context;
    this.context.clearRect(0, 0, canvas.width, canvas.height);
    paint(this.context, canvas.width, canvas.height);
    this.#texture.needsUpdate = true;
  }
}

/**
 * A canvas that is not part of the page.
 * @param {number} width
 * @param {number} height
 */
export function canvasOf(width, height) {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  return canvas;
}

/**
 * Text in lines of a width; returns the height below the last one.
 * @param {CanvasRenderingContext2D} context
 * @param {string} text
 * @param {[number, number]} at Left end of the first base line.
 * @param {number} width
 * @param {number} line_height
 * @param {number} most Lines at most; the last one ends with dots if more would follow.
 */
export function wrapped(context, text, [x, y], width, line_height, most = 3) {
  const words = text.split(" ");
  for (let line = 1; line <= most && words.length > 0; line += 1, y += line_height) {
    let part = words.shift() ?? "";
    while (words.length > 0 && context.measureText(`${part} ${words[0]}`).width <= width) part += ` ${words.shift()}`;
    context.fillText(line === most && words.length > 0 ? `${part}…` : part, x, y);
  }
  return y;
}

/**
 * The vessel below a recorded trial, and the word that says whose motion it was not.
 * @module
 */

import { COLORS } from "./marks.js";

/** @import { Pair } from "./types.js" */

const LUMEN = "#2f363d";

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Pair[][]} walls_px Closed lines in the vessel's grid.
 * @param {(x: number, y: number) => Pair} place From the grid to the canvas.
 */
export function drawVessel(context, walls_px, place) {
  context.beginPath();
  for (const wall of walls_px) {
    wall.forEach(([x, y], i) => (i === 0 ? context.moveTo(...place(x, y)) : context.lineTo(...place(x, y))));
    context.closePath();
  }
  context.fillStyle = LUMEN;
  context.fill("evenodd");
  context.lineWidth = 1;
  context.strokeStyle = COLORS.muted;
  context.stroke();
}

/** @param {CanvasRenderingContext2D} context @param {number} size Of the square canvas. */
export function drawWatermark(context, size) {
  context.save();
  context.translate(size / 2, size / 2);
  context.rotate(-Math.PI / 6);
  context.font = `700 ${Math.round(size / 7)}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.globalAlpha = 0.13;
  context.fillStyle = COLORS.text;
  context.fillText("simulated", 0, 0);
  context.restore();
}

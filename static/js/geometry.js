/**
 * Planar affine maps. Maps read backwards: `image = apply(image_from_vessel, vessel)`.
 * @module
 */

/** @import { AffineRows, Pair } from "./types.js" */

/**
 * @param {AffineRows} rows
 * @param {Pair} point
 * @returns {Pair}
 */
export function apply([[a, b, tx], [c, d, ty]], [x, y]) {
  return [a * x + b * y + tx, c * x + d * y + ty];
}

/**
 * How many units of the output frame one unit of the input frame is (mean over directions).
 * @param {AffineRows} rows
 * @returns {number}
 */
export function scaleOf([[a, b], [c, d]]) {
  return Math.sqrt(Math.abs(a * d - b * c));
}

/**
 * Map a difference of two points.
 * @param {AffineRows} rows
 * @param {Pair} difference
 * @returns {Pair}
 */
export function applyLinear([[a, b], [c, d]], [x, y]) {
  return [a * x + b * y, c * x + d * y];
}

/**
 * The map backwards.
 * @param {AffineRows} rows
 * @returns {AffineRows}
 */
export function inverse([[a, b, tx], [c, d, ty]]) {
  const area = a * d - b * c;
  return [
    [d / area, -b / area, (b * ty - d * tx) / area],
    [-c / area, a / area, (c * tx - a * ty) / area],
  ];
}

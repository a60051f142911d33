/**
 * The marks on the picture: one colour, one shape and one meaning each (css/tokens.css holds the colours).
 * Every mark has a dark casing, so that it reads on bright and on dark tissue alike.
 * @module
 */

/** @import { Pair } from "./types.js" */

const style = getComputedStyle(document.documentElement);
/** @param {string} name */
const color = (name) => style.getPropertyValue(name).trim();

export const COLORS = {
  robot: color("--mark-robot"),
  tip: color("--mark-tip"),
  area: color("--mark-area"),
  path: color("--mark-path"),
  warning: color("--mark-warning"),
  hand: color("--mark-hand"),
  camera: color("--mark-camera"),
  casing: color("--mark-casing"),
  text: color("--text"),
  muted: color("--text-muted"),
  line: color("--line"),
};

const FONT = "600 13px system-ui, sans-serif";

/**
 * Stroke the present path with a casing below it.
 * @param {CanvasRenderingContext2D} context
 * @param {string} stroke
 * @param {number} width
 */
function strokeCased(context, stroke, width) {
  context.lineWidth = width + 2.5;
  context.strokeStyle = COLORS.casing;
  context.stroke();
  context.lineWidth = width;
  context.strokeStyle = stroke;
  context.stroke();
}

/**
 * The robot: a ring around its rim; broken while the tracker is not sure.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} at
 * @param {number} radius
 * @param {boolean} sure
 */
export function robotRing(context, [x, y], radius, sure) {
  context.setLineDash(sure ? [] : [5, 5]);
  context.beginPath();
  context.arc(x, y, radius + 2, 0, 2 * Math.PI);
  strokeCased(context, COLORS.robot, 2.5);
  context.setLineDash([]);
}

/**
 * The vessel model's walls: thin closed lines.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair[][]} lines
 */
export function outline(context, lines) {
  context.beginPath();
  for (const line of lines) {
    line.forEach(([x, y], index) => (index === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
    context.closePath();
  }
  strokeCased(context, COLORS.text, 1);
}

/**
 * The end-effector: an open cross.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} at
 */
export function tipCross(context, [x, y]) {
  const inner = 4;
  const outer = 15;
  context.lineCap = "round";
  context.beginPath();
  for (const [dx, dy] of /** @type {Pair[]} */ ([[1, 0], [-1, 0], [0, 1], [0, -1]])) {
    context.moveTo(x + dx * inner, y + dy * inner);
    context.lineTo(x + dx * outer, y + dy * outer);
  }
  strokeCased(context, COLORS.tip, 2.5);
  context.lineCap = "butt";
}

/**
 * Where the end-effector was seen in the picture: a small diamond, within the cross if all is well.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} at
 */
export function tipSeen(context, [x, y]) {
  const reach = 6;
  context.beginPath();
  context.moveTo(x + reach, y);
  context.lineTo(x, y + reach);
  context.lineTo(x - reach, y);
  context.lineTo(x, y - reach);
  context.closePath();
  strokeCased(context, COLORS.tip, 1.5);
}

/**
 * The policy's path: a line that ends in an arrow head.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair[]} points
 */
export function pathLine(context, points) {
  const end = points.at(-1);
  const before = points.at(-2);
  if (!end || !before) return;
  context.lineJoin = "round";
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  const heading = Math.atan2(end[1] - before[1], end[0] - before[0]);
  for (const side of [-1, 1]) {
    const angle = heading + Math.PI + side * 0.5;
    context.moveTo(end[0], end[1]);
    context.lineTo(end[0] + 10 * Math.cos(angle), end[1] + 10 * Math.sin(angle));
  }
  strokeCased(context, COLORS.path, 2);
  context.lineJoin = "miter";
}

/**
 * A critical area: a circle of radius ε (dashed; solid for the one that Auto goes to) around a diamond.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} at
 * @param {number} radius
 * @param {string} label
 * @param {{chosen: boolean, active: boolean}} is
 */
export function criticalArea(context, [x, y], radius, label, is) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  if (is.active) {
    context.globalAlpha = 0.2;
    context.fillStyle = COLORS.area;
    context.fill();
    context.globalAlpha = 1;
  }
  context.setLineDash(is.chosen || is.active ? [] : [6, 5]);
  strokeCased(context, COLORS.area, is.chosen || is.active ? 3 : 2);
  context.setLineDash([]);
  context.beginPath();
  context.moveTo(x, y - 6);
  context.lineTo(x + 6, y);
  context.lineTo(x, y + 6);
  context.lineTo(x - 6, y);
  context.closePath();
  strokeCased(context, COLORS.area, 2);
  if (is.chosen || is.active) {
    context.fillStyle = COLORS.area;
    context.fill();
  }
  if (label) tag(context, [x, y - radius - 8], label);
}

/**
 * The hand that steers: a line from where its clutch closed to where it is.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} from
 * @param {Pair} to
 */
export function clutchLine(context, from, to) {
  context.beginPath();
  context.arc(from[0], from[1], 5, 0, 2 * Math.PI);
  context.moveTo(from[0], from[1]);
  context.lineTo(to[0], to[1]);
  strokeCased(context, COLORS.hand, 2.5);
  tag(context, [to[0], to[1] - 16], "You steer");
}

/**
 * A short text on a dark plate, centred above a point and kept inside the picture.
 * @param {CanvasRenderingContext2D} context
 * @param {Pair} at Middle of the plate's lower edge, in CSS pixels.
 * @param {string} text
 */
export function tag(context, [x, y], text) {
  context.font = FONT;
  context.textBaseline = "middle";
  context.textAlign = "center";
  const width = context.measureText(text).width + 12;
  const height = 20;
  const { a: density } = context.getTransform();
  const left = Math.min(Math.max(x - width / 2, 4), context.canvas.width / density - width - 4);
  const top = Math.max(y - height, 4);
  context.fillStyle = COLORS.casing;
  context.beginPath();
  context.roundRect(left, top, width, height, 4);
  context.fill();
  context.fillStyle = COLORS.text;
  context.fillText(text, left + width / 2, top + height / 2 + 0.5);
}

/**
 * A bar of known length at the lower left.
 * @param {CanvasRenderingContext2D} context
 * @param {number} length_css
 * @param {string} text
 * @param {number} bottom Height of the picture in CSS pixels.
 */
export function scaleBar(context, length_css, text, bottom) {
  const [left, y] = [16, bottom - 16];
  context.beginPath();
  context.moveTo(left, y - 5);
  context.lineTo(left, y);
  context.lineTo(left + length_css, y);
  context.lineTo(left + length_css, y - 5);
  strokeCased(context, COLORS.text, 2);
  tag(context, [left + length_css / 2, y - 8], text);
}

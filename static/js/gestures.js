/**
 * What a pointer or a key on the picture means: mark and size an area, steer, or look elsewhere.
 * @module
 */

import { apply, applyLinear, inverse, scaleOf } from "./geometry.js";

/** @import { CriticalArea, Pair } from "./types.js" */
/** @import { Scene } from "./overlay.js" */
/** @import { PageHand } from "./page-hand.js" */
/** @import { Tool } from "./tools.js" */
/** @import { Viewport } from "./viewport.js" */

const CLICK_CSS = 6;
const RIM_CSS = 10;
const STEP_CSS = 12;
const EPSILON_UM = /** @type {const} */ ([50, 3000]);

/**
 * An area that is being marked, moved or sized.
 * @typedef {object} Draft
 * @property {string | null} id Null for a new one.
 * @property {Pair} image_px
 * @property {number} epsilon_um
 */

/**
 * @typedef {object} GestureHandlers
 * @property {() => Scene | null} scene
 * @property {() => Tool} tool
 * @property {(draft: Draft) => void} onDraft An area was marked, moved or sized.
 * @property {(id: string) => void} onChoose
 * @property {() => void} onChange Something to draw anew.
 */

export class Gestures {
  #canvas;
  #viewport;
  #hand;
  #handlers;
  /** Pointers that are down, where they were last. @type {Map<number, Pair>} */ #down = new Map();
  /** @type {{start: Pair, area: CriticalArea | null, rim: boolean, moved: boolean} | null} */ #marking = null;
  /** @type {Draft | null} */ draft = null;
  /** Pointer or keyboard's cross over the picture, in CSS pixels. @type {Pair | null} */ pointer = null;
  /** Where the pointer that steers went down. @type {Pair | null} */ steeringFrom = null;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Viewport} viewport
   * @param {PageHand} hand
   * @param {GestureHandlers} handlers
   */
  constructor(canvas, viewport, hand, handlers) {
    this.#canvas = canvas;
    this.#viewport = viewport;
    this.#hand = hand;
    this.#handlers = handlers;
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    canvas.addEventListener("pointerup", (event) => this.#lift(event, true));
    for (const name of /** @type {const} */ (["pointercancel", "lostpointercapture"])) {
      canvas.addEventListener(name, (event) => this.#lift(event, false));
    }
    canvas.addEventListener("pointerleave", () => this.#point(null));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("blur", () => this.#point(null));
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  /** The area at a point, if any. @param {Pair} css @param {Scene} scene */
  areaAt(css, scene) {
    return scene.areas.find((area) => this.#away(css, area, scene) <= Math.max(this.#radius(area, scene), 16));
  }

  /** @param {PointerEvent} event */
  #press(event) {
    if (event.button !== 0 && event.button !== 1) return;
    const css = /** @type {Pair} */ ([event.offsetX, event.offsetY]);
    this.#canvas.setPointerCapture(event.pointerId);
    this.#down.set(event.pointerId, css);
    const tool = event.button === 1 || this.#down.size > 1 ? "pan" : this.#handlers.tool();
    if (this.#down.size > 1) this.#cancel();
    else if (tool === "steer") this.#steer(css);
    else if (tool === "mark") this.#beginMark(css);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const css = /** @type {Pair} */ ([event.offsetX, event.offsetY]);
    const before = this.#down.get(event.pointerId);
    if (event.pointerType === "mouse" || before) this.#point(css);
    if (!before) return;
    const others = [...this.#down].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    this.#down.set(event.pointerId, css);
    const way = /** @type {Pair} */ ([css[0] - before[0], css[1] - before[1]]);
    if (others[0]) this.#pinch(others[0], before, css);
    else if (this.steeringFrom) this.#drag(way, event);
    else if (this.#marking) this.#size(css);
    else this.#viewport.pan(way);
  }

  /** @param {PointerEvent} event @param {boolean} meant False if the browser took the pointer away. */
  #lift(event, meant) {
    if (!this.#down.delete(event.pointerId)) return;
    const marking = this.#marking;
    if (meant && marking) {
      if (this.draft && (marking.moved || !marking.area)) this.#handlers.onDraft(this.draft);
      else if (marking.area) this.#handlers.onChoose(marking.area.id);
    }
    this.#cancel();
  }

  #cancel() {
    this.#marking = this.draft = null;
    if (this.steeringFrom) this.#hand.open("pointer");
    this.steeringFrom = null;
    this.#handlers.onChange();
  }

  /** @param {Pair} css */
  #steer(css) {
    if (this.#hand.close("pointer")) this.steeringFrom = css;
    this.#handlers.onChange();
  }

  /** @param {Pair} way @param {PointerEvent} event */
  #drag([dx, dy], event) {
    const outside =
      event.clientX < 0 || event.clientY < 0 || event.clientX >= innerWidth || event.clientY >= innerHeight;
    const scene = this.#handlers.scene();
    if (outside || !scene || this.#hand.holder !== "pointer") {
      this.#cancel();
      return;
    }
    const { image_from_vessel, stage_from_vessel } = scene.snapshot.calibration;
    const px = this.#viewport.css_per_px;
    const vessel = applyLinear(inverse(image_from_vessel), [dx / px, dy / px]);
    this.#hand.move(applyLinear(stage_from_vessel, vessel));
    this.#handlers.onChange();
  }

  /** @param {Pair} css */
  #beginMark(css) {
    const scene = this.#handlers.scene();
    if (!scene) return;
    const rimmed = scene.areas.find(
      (area) => Math.abs(this.#away(css, area, scene) - this.#radius(area, scene)) <= RIM_CSS,
    );
    const area = rimmed ?? this.areaAt(css, scene) ?? null;
    if (!area && !scene.mayMark) return;
    this.#marking = { start: css, area, rim: rimmed !== undefined, moved: false };
    if (!area) {
      const image_px = this.#viewport.toImage(css);
      this.draft = { id: null, image_px, epsilon_um: scene.newEpsilon_um };
    }
  }

  /** @param {Pair} css */
  #size(css) {
    const scene = this.#handlers.scene();
    const marking = this.#marking;
    if (!scene || !marking || !scene.mayMark) return;
    const { start, area, rim } = marking;
    if (!marking.moved && Math.hypot(css[0] - start[0], css[1] - start[1]) < CLICK_CSS) return;
    marking.moved = true;
    const center = area ? this.#center(area, scene) : start;
    if (area && !rim) {
      const at = /** @type {Pair} */ ([center[0] + css[0] - start[0], center[1] + css[1] - start[1]]);
      this.draft = { id: area.id, image_px: this.#viewport.toImage(at), epsilon_um: area.epsilon_um };
    } else {
      const radius = Math.hypot(css[0] - center[0], css[1] - center[1]) / this.#css_per_um(scene);
      const epsilon_um = Math.min(Math.max(Math.round(radius / 10) * 10, EPSILON_UM[0]), EPSILON_UM[1]);
      this.draft = { id: area?.id ?? null, image_px: this.#viewport.toImage(center), epsilon_um };
    }
    this.#handlers.onChange();
  }

  /** @param {Pair} still @param {Pair} before @param {Pair} after */
  #pinch(still, before, after) {
    const [was, is] = [before, after].map(([x, y]) => Math.hypot(x - still[0], y - still[1]));
    if (was && is) this.#viewport.zoom(is / was, [(still[0] + after[0]) / 2, (still[1] + after[1]) / 2]);
    this.#viewport.pan([(after[0] - before[0]) / 2, (after[1] - before[1]) / 2]);
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    event.preventDefault();
    // While a hand steers, the picture stands still under it.
    if (!this.steeringFrom) this.#viewport.zoom(Math.exp(-event.deltaY / 500), [event.offsetX, event.offsetY]);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const zoom = { "+": 1.5, "=": 1.5, "-": 1 / 1.5 }[event.key];
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const tool = this.#handlers.tool();
    if (zoom) this.#viewport.zoom(zoom);
    else if (event.key === "0") this.#viewport.fit();
    else if (event.key === "Enter" && tool === "mark") this.#markHere();
    else if (way && tool === "pan") this.#viewport.pan([-4 * STEP_CSS * (way[0] ?? 0), -4 * STEP_CSS * (way[1] ?? 0)]);
    else if (way && tool === "mark") this.#walk([way[0] ?? 0, way[1] ?? 0], event.shiftKey);
    else return;
    event.preventDefault();
  }

  /** @param {Pair} way @param {boolean} far */
  #walk([dx, dy], far) {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    const [x, y] = this.pointer ?? [width / 2, height / 2];
    const step = far ? 5 * STEP_CSS : STEP_CSS / 2;
    this.#point([
      Math.min(Math.max(x + dx * step, 0), width),
      Math.min(Math.max(y + dy * step, 0), height),
    ]);
  }

  #markHere() {
    const scene = this.#handlers.scene();
    if (!scene || !this.pointer) return;
    const area = this.areaAt(this.pointer, scene);
    if (area) this.#handlers.onChoose(area.id);
    else if (scene.mayMark) {
      const image_px = this.#viewport.toImage(this.pointer);
      this.#handlers.onDraft({ id: null, image_px, epsilon_um: scene.newEpsilon_um });
    }
  }

  /** @param {Pair | null} css */
  #point(css) {
    this.pointer = css;
    this.#handlers.onChange();
  }

  /** @param {Scene} scene */
  #css_per_um({ snapshot }) {
    const { image_from_vessel, um_per_px } = snapshot.calibration;
    return (scaleOf(image_from_vessel) * this.#viewport.css_per_px) / um_per_px;
  }

  /** @param {CriticalArea} area @param {Scene} scene */
  #radius(area, scene) {
    return area.epsilon_um * this.#css_per_um(scene);
  }

  /** @param {CriticalArea} area @param {Scene} scene @returns {Pair} */
  #center(area, { snapshot }) {
    const { x_px, y_px } = area.center;
    return this.#viewport.toScreen(apply(snapshot.calibration.image_from_vessel, [x_px, y_px]));
  }

  /** @param {Pair} css @param {CriticalArea} area @param {Scene} scene */
  #away([x, y], area, scene) {
    const [cx, cy] = this.#center(area, scene);
    return Math.hypot(cx - x, cy - y);
  }
}

/**
 * The microscope's picture: newest frame wins, nothing queues.
 * @module
 */

import { decodeJpeg } from "./jpeg.js";
import { ReconnectingSocket } from "./socket.js";

/** @import { Picture } from "./jpeg.js" */
/** @import { Link } from "./socket.js" */

const HEADER_BYTES = 16;
const RATE_WINDOW_MS = 2000;

export class VideoView {
  #context;
  #canvas;
  #socket;
  #onFirstFrame;
  /** @type {ArrayBuffer | null} */ #next = null;
  #decoding = false;
  /** @type {number[]} */ #drawn_ms = [];
  /** @type {Link} */ link = "connecting";
  /** When a frame was last drawn, on the page's clock. */
  last_ms = -Infinity;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{onFirstFrame: () => void}} handlers
   */
  constructor(canvas, { onFirstFrame }) {
    const context = canvas.getContext("2d", { alpha: false });
    if (!context) throw new Error("the browser offers no 2D canvas");
    this.#canvas = canvas;
    this.#context = context;
    this.#onFirstFrame = onFirstFrame;
    this.#socket = new ReconnectingSocket({
      path: "/ws/video?width=800&quality=75",
      silence_ms: 3000,
      onMessage: (data) => {
        if (typeof data !== "string" && data.byteLength > HEADER_BYTES) {
          this.#next = data;
          void this.#decode();
        }
      },
      onLink: (link) => {
        this.link = link;
      },
    });
  }

  /** Connect, and stay connected. */
  start() {
    this.#socket.open();
  }

  /**
   * Frames drawn per second over the last two seconds.
   * @param {number} now_ms
   * @returns {number}
   */
  fps(now_ms) {
    this.#drawn_ms = this.#drawn_ms.filter((drawn_ms) => now_ms - drawn_ms < RATE_WINDOW_MS);
    return this.#drawn_ms.length / (RATE_WINDOW_MS / 1000);
  }

  async #decode() {
    if (this.#decoding) return;
    this.#decoding = true;
    try {
      while (this.#next) {
        const jpeg = new Uint8Array(this.#next, HEADER_BYTES);
        this.#next = null;
        // A damaged frame is skipped: the next one comes in 33 ms.
        const picture = await decodeJpeg(jpeg);
        if (picture) this.#draw(picture);
      }
    } finally {
      this.#decoding = false;
    }
  }

  /** @param {Picture} picture */
  #draw({ image, width, height, close }) {
    if (this.#canvas.width !== width || this.#canvas.height !== height) {
      this.#canvas.width = width;
      this.#canvas.height = height;
    }
    this.#context.drawImage(image, 0, 0);
    close();
    const now_ms = performance.now();
    if (this.last_ms === -Infinity) this.#onFirstFrame();
    this.last_ms = now_ms;
    this.#drawn_ms.push(now_ms);
  }
}

/**
 * The microscope's picture: newest frame wins, nothing queues.
 * @module
 */

import { decodesH264, H264Decoder } from "./h264.js";
import { decodeJpeg } from "./jpeg.js";
import { ReconnectingSocket } from "./socket.js";

/** @import { Picture } from "./jpeg.js" */
/** @import { Link } from "./socket.js" */

const HEADER_BYTES = 16;
const RATE_WINDOW_MS = 2000;
const PATH = "/ws/video?width=800&quality=75";
/** The header's second number. */
const FORMAT = { jpeg: 0, h264Key: 1 };

export class VideoView {
  #context;
  #canvas;
  #socket;
  #onFirstFrame;
  #takesH264 = false;
  /** @type {H264Decoder | null} */ #h264 = null;
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
    const path = () => (this.#takesH264 ? `${PATH}&codec=h264` : PATH);
    this.#socket = new ReconnectingSocket({
      get path() {
        return path();
      },
      silence_ms: 3000,
      onMessage: (data) => {
        if (typeof data !== "string" && data.byteLength > HEADER_BYTES) this.#take(data);
      },
      onLink: (link) => {
        this.link = link;
        if (link === "lost") this.#endH264();
      },
    });
  }

  /** Connect, and stay connected. */
  async start() {
    this.#takesH264 = await decodesH264();
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

  /** The server chooses among what is taken, and says of each picture what it is. @param {ArrayBuffer} message */
  #take(message) {
    const header = new DataView(message, 0, HEADER_BYTES);
    const format = header.getUint32(4, true);
    if (format === FORMAT.jpeg) {
      this.#next = message;
      void this.#decode();
      return;
    }
    this.#h264 ??= new H264Decoder({
      onPicture: (picture) => this.#draw(picture),
      onFailure: () => this.#refuseH264(),
    });
    this.#h264.push(new Uint8Array(message, HEADER_BYTES), format === FORMAT.h264Key, header.getFloat64(8, true));
  }

  #endH264() {
    this.#h264?.close();
    this.#h264 = null;
  }

  /** A decoder that fails will fail again: JPEG from here on. */
  #refuseH264() {
    this.#endH264();
    this.#takesH264 = false;
    this.#socket.renew();
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

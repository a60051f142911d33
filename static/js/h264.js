/**
 * H.264 to pixels, by the browser's own decoder.
 * @module
 */

/** @import { Picture } from "./jpeg.js" */

const CODEC = "avc1.42C01F";
const NAMES_PROFILE = 0x67;

/** Whether this browser decodes H.264; only secure contexts do (https, or this machine). */
export async function decodesH264() {
  if (!("VideoDecoder" in globalThis)) return false;
  try {
    return (await VideoDecoder.isConfigSupported({ codec: CODEC, optimizeForLatency: true })).supported === true;
  } catch {
    return false;
  }
}

/** Decodes one stream; a picture that builds on others needs all of them, so none is left out. */
export class H264Decoder {
  #decoder;
  #onFailure;
  #codec = "";

  /** @param {{onPicture: (picture: Picture) => void, onFailure: () => void}} handlers */
  constructor({ onPicture, onFailure }) {
    this.#onFailure = onFailure;
    this.#decoder = new VideoDecoder({
      output: (image) =>
        onPicture({ image, width: image.displayWidth, height: image.displayHeight, close: () => image.close() }),
      error: onFailure,
    });
  }

  /**
   * @param {Uint8Array<ArrayBuffer>} data Annex B.
   * @param {boolean} isKey Whether it stands by itself.
   * @param {number} taken_s
   */
  push(data, isKey, taken_s) {
    if (this.#decoder.state === "closed") return;
    try {
      if (isKey) this.#configure(data);
      if (this.#codec === "") return;
      this.#decoder.decode(new EncodedVideoChunk({ type: isKey ? "key" : "delta", timestamp: 1e6 * taken_s, data }));
    } catch {
      this.#onFailure();
    }
  }

  close() {
    if (this.#decoder.state !== "closed") this.#decoder.close();
  }

  /** Profile and level stand behind the first start code. @param {Uint8Array} data */
  #configure(data) {
    if (data[4] !== NAMES_PROFILE) return;
    const codec = `avc1.${[...data.subarray(5, 8)].map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
    if (codec === this.#codec) return;
    this.#codec = codec;
    this.#decoder.configure({ codec, optimizeForLatency: true });
  }
}

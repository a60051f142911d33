/**
 * JPEG to pixels, by the shortest way that the browser has.
 * @module
 */

/**
 * @typedef {object} Picture
 * @property {CanvasImageSource} image
 * @property {number} width
 * @property {number} height
 * @property {() => void} close Frees the pixels.
 */

const TYPE = "image/jpeg";

/**
 * Decode one picture; null if it is damaged.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @returns {Promise<Picture | null>}
 */
export async function decodeJpeg(bytes) {
  try {
    return "ImageDecoder" in globalThis ? await decoded(bytes) : await bitmap(bytes);
  } catch {
    return null;
  }
}

/**
 * Straight from memory; only secure contexts have it (https, or this machine).
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @returns {Promise<Picture>}
 */
async function decoded(bytes) {
  const decoder = new ImageDecoder({ data: bytes, type: TYPE });
  try {
    const { image } = await decoder.decode();
    return { image, width: image.displayWidth, height: image.displayHeight, close: () => image.close() };
  } finally {
    decoder.close();
  }
}

/**
 * By way of a blob, which visits the browser's own process and takes some milliseconds more.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @returns {Promise<Picture>}
 */
async function bitmap(bytes) {
  const image = await createImageBitmap(new Blob([bytes], { type: TYPE }));
  return { image, width: image.width, height: image.height, close: () => image.close() };
}

/**
 * Other tabs of this browser that show the same dashboard.
 * @module
 */

const ASK = "who is there";

export class Siblings {
  #channel = new BroadcastChannel("mrnav dashboard");
  #seat = "";
  /** @type {Set<string>} */ #seats = new Set();

  constructor() {
    this.#channel.onmessage = ({ data }) => {
      if (data === ASK) this.#tell();
      else if (typeof data === "string") this.#seats.add(data);
    };
  }

  /** This page's own name. @param {string} seat */
  introduce(seat) {
    this.#seat = seat;
    this.#tell();
    this.#channel.postMessage(ASK);
  }

  /** Whether a seat belongs to another tab of this browser. @param {string | null} seat */
  include(seat) {
    return seat !== null && this.#seats.has(seat);
  }

  #tell() {
    if (this.#seat) this.#channel.postMessage(this.#seat);
  }
}

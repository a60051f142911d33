/**
 * A WebSocket that comes back by itself.
 * @module
 */

const FIRST_WAIT_MS = 100;
const LONGEST_WAIT_MS = 500;
const CONNECT_TIMEOUT_MS = 3000;

/** @typedef {"connecting" | "open" | "lost"} Link */

/**
 * @typedef {object} SocketOptions
 * @property {string} path
 * @property {number} silence_ms A link that is silent for longer counts as dead and is opened anew.
 * @property {(data: string | ArrayBuffer) => void} onMessage
 * @property {(link: Link, everOpened: boolean) => void} onLink `everOpened` tells, for "lost", whether this
 *   attempt had been accepted.
 */

export class ReconnectingSocket {
  /** @type {WebSocket | null} */ #socket = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #timer;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #watchdog;
  #wait_ms = FIRST_WAIT_MS;
  #options;
  /** @type {Link} */ link = "connecting";

  /** @param {SocketOptions} options */
  constructor(options) {
    this.#options = options;
    addEventListener("online", () => this.#hurry());
    document.addEventListener("visibilitychange", () => {
      if (!document.hidden) this.#hurry();
    });
  }

  /** Open the link, and keep it open from now on. */
  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}${this.#options.path}`);
    socket.binaryType = "arraybuffer";
    let opened = false;
    this.#socket = socket;
    this.#expect(CONNECT_TIMEOUT_MS);
    socket.onopen = () => {
      opened = true;
      this.#expect(this.#options.silence_ms);
      this.#change("open", true);
    };
    socket.onmessage = (message) => {
      if (socket !== this.#socket) return;
      // Only a message proves that the link works: a server that accepts and closes is no reason to hurry.
      this.#wait_ms = FIRST_WAIT_MS;
      this.#expect(this.#options.silence_ms);
      this.#options.onMessage(message.data);
    };
    socket.onclose = () => {
      if (socket === this.#socket) this.#again(opened);
    };
  }

  /** Leave the link and open it anew, by the path that the options name by now. */
  renew() {
    this.#abandon();
    this.open();
  }

  /**
   * Send text now, or tell that it cannot be sent; nothing is queued, because late commands are dangerous.
   * @param {unknown} message
   * @returns {boolean}
   */
  send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  /** @param {number} limit_ms */
  #expect(limit_ms) {
    clearTimeout(this.#watchdog);
    this.#watchdog = setTimeout(() => {
      const opened = this.#socket?.readyState === WebSocket.OPEN;
      this.#abandon();
      this.#again(opened);
    }, limit_ms);
  }

  #abandon() {
    const socket = this.#socket;
    this.#socket = null;
    clearTimeout(this.#timer);
    clearTimeout(this.#watchdog);
    socket?.close();
  }

  /** @param {boolean} opened */
  #again(opened) {
    clearTimeout(this.#watchdog);
    clearTimeout(this.#timer);
    this.#socket = null;
    this.#change("lost", opened);
    const wait_ms = this.#wait_ms * (0.8 + 0.4 * Math.random());
    this.#wait_ms = Math.min(this.#wait_ms * 2, LONGEST_WAIT_MS);
    this.#timer = setTimeout(() => this.open(), wait_ms);
  }

  #hurry() {
    if (this.#socket !== null) return;
    clearTimeout(this.#timer);
    this.#wait_ms = FIRST_WAIT_MS;
    this.open();
  }

  /** @param {Link} link @param {boolean} opened */
  #change(link, opened) {
    this.link = link;
    this.#options.onLink(link, opened);
  }
}

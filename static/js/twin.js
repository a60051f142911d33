/**
 * The twin stream: newest state, events, and asks with their answers.
 * @module
 */

import { ReconnectingSocket } from "./socket.js";

/** @import { Answer, Ask, HandLease, HandMessage, Snapshot, State, TwinEvent, TwinMessage } from "./types.js" */
/** @import { Link } from "./socket.js" */

const HEARTBEAT_MS = 200;
const ANSWER_TIMEOUT_MS = 3000;

/**
 * @typedef {object} TwinHandlers
 * @property {(snapshot: Snapshot) => void} onSnapshot
 * @property {(state: State) => void} onState
 * @property {(event: TwinEvent) => void} onEvent
 * @property {(lease: HandLease) => void} onHandLease Whether this page is the rig's hand.
 * @property {(link: Link, everOpened: boolean) => void} onLink
 */

export class TwinClient {
  #handlers;
  #socket;
  /** Answers come in the order of the asks. @type {((answer: Answer) => void)[]} */
  #waiting = [];
  #supervising = false;

  /** @param {TwinHandlers} handlers */
  constructor(handlers) {
    this.#handlers = handlers;
    this.#socket = new ReconnectingSocket({
      path: "/ws/twin",
      silence_ms: 1500,
      onMessage: (data) => this.#receive(JSON.parse(String(data))),
      onLink: (link, everOpened) => {
        if (link === "lost") this.#abandonAsks();
        handlers.onLink(link, everOpened);
      },
    });
  }

  /** Connect, and stay connected. */
  start() {
    this.#socket.open();
    setInterval(() => {
      // A hidden page shows nobody the robot: it must not vouch for an operator who watches.
      if (this.#supervising && !document.hidden) this.#socket.send({ type: "heartbeat" });
    }, HEARTBEAT_MS);
  }

  /**
   * Ask for a mode.
   * @param {Ask} ask
   * @param {string} [area] Id of the critical area, for "auto".
   * @returns {Promise<Answer>} A refusal, too, is an answer; this never rejects.
   */
  ask(ask, area) {
    return new Promise((resolve) => {
      const message = area === undefined ? { type: "ask", ask } : { type: "ask", ask, area };
      if (!this.#socket.send(message)) {
        resolve(failed("not_connected", "Not connected to the server: the command was not sent."));
        return;
      }
      this.#waiting.push(resolve);
      setTimeout(() => resolve(failed("no_answer", "The server did not answer.")), ANSWER_TIMEOUT_MS);
    });
  }

  /**
   * Ask to be the rig's hand; the answer comes as `onHandLease`.
   * @param {string} client
   * @param {"stage" | "webxr"} frame Axes of the positions.
   * @returns {boolean} Whether it could be sent.
   */
  takeHand(client, frame) {
    return this.#socket.send({ type: "take_hand", client, frame });
  }

  /** Be the hand no longer. */
  giveHand() {
    this.#socket.send({ type: "give_hand" });
  }

  /** @param {HandMessage} message @returns {boolean} Whether it could be sent. */
  sendHand(message) {
    return this.#socket.send(message);
  }

  /** @param {TwinMessage} message */
  #receive(message) {
    switch (message.type) {
      case "state":
        this.#handlers.onState(message);
        break;
      case "snapshot":
        this.#supervising = message.role === "operator";
        this.#handlers.onSnapshot(message);
        break;
      case "event":
        this.#handlers.onEvent(message);
        break;
      case "lease":
        this.#handlers.onHandLease(message);
        break;
      case "answer":
        this.#waiting.shift()?.(message);
        break;
    }
  }

  #abandonAsks() {
    for (const resolve of this.#waiting.splice(0)) {
      resolve(failed("connection_lost", "The connection was lost before the server answered."));
    }
  }
}

/**
 * @param {string} code
 * @param {string} message
 * @returns {Answer}
 */
function failed(code, message) {
  return { type: "answer", ok: false, code, message };
}

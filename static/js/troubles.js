/**
 * What keeps the page from being trusted or used, and what to do about it. Plain functions of what is known.
 * @module
 */

/** @import { Snapshot, State } from "./types.js" */
/** @import { Link } from "./socket.js" */

export const TWIN_VERSION = 1;

/**
 * @typedef {object} Situation
 * @property {Snapshot | null} snapshot
 * @property {State | null} state
 * @property {boolean} fresh Whether the state is recent enough to act on.
 * @property {boolean} signedOut
 * @property {Link} link
 * @property {string} receivedAt Time of day of the last state, for people.
 * @property {boolean} videoLive
 */

/**
 * What to tell over the picture; "" while all is well.
 * @param {Situation} situation
 * @returns {string}
 */
export function trouble({ snapshot, state, fresh, signedOut, link, receivedAt, videoLive }) {
  if (signedOut) {
    return "Not signed in. Open the address with the token that the server printed when it started.";
  }
  if (snapshot && snapshot.v !== TWIN_VERSION) {
    return (
      `The server speaks version ${snapshot.v}, this page version ${TWIN_VERSION}. Reload the page; if that ` +
      "does not help, restart the server that you installed last. Only STOP is left on."
    );
  }
  if (!state) return "Connecting to the server…";
  if (!fresh) {
    const does =
      link === "open"
        ? "The server is silent. Is its computer overloaded?"
        : "Reconnecting by itself. If it lasts, look whether the server runs and the network is up.";
    return `No data since ${receivedAt}. ${does} What you see is old; the rig holds without you.`;
  }
  if (!videoLive && (state.rates_hz.camera ?? 0) < 1) {
    return "The camera gives no picture: look at its cable and its light. Nothing drives itself meanwhile.";
  }
  if (!videoLive) return "The picture does not arrive; the robot is tracked all the same. Reconnecting by itself.";
  return "";
}

/**
 * Whether this browser can show the headset page, and what is missing. Said before anybody enters.
 * @module
 */

/// <reference types="webxr" />

/** @import { Link } from "../socket.js" */
/** @import { Role } from "../types.js" */

/** @typedef {"immersive-ar" | "immersive-vr"} Immersion */

/**
 * @typedef {object} Found
 * @property {boolean} secure Whether the page came over https, or from this machine.
 * @property {boolean} webxr Whether the browser knows WebXR.
 * @property {Immersion | null} immersion The best that browser and headset offer.
 * @property {boolean} webgl
 * @property {Link} link To the server.
 * @property {boolean} signedOut
 * @property {Role | null} role
 */

/**
 * @typedef {object} Check
 * @property {string} name
 * @property {"ok" | "missing" | "warning" | "waiting"} verdict
 * @property {string} text What was found, or what to do.
 */

/**
 * What can be told without a session.
 * @returns {Promise<{secure: boolean, webxr: boolean, immersion: Immersion | null, webgl: boolean}>}
 */
export async function look() {
  const xr = navigator.xr;
  /** @type {Immersion | null} */ let immersion = null;
  for (const mode of /** @type {Immersion[]} */ (["immersive-vr", "immersive-ar"])) {
    // A browser may refuse to tell: then it has none.
    if (await xr?.isSessionSupported(mode).catch(() => false)) immersion = mode;
  }
  const webgl = document.createElement("canvas").getContext("webgl2") !== null;
  return { secure: isSecureContext, webxr: xr !== undefined, immersion, webgl };
}

/**
 * The checks as a person reads them, and whether a session can begin.
 * @param {Found} found
 * @returns {{checks: Check[], ready: boolean}}
 */
export function assess(found) {
  const checks = [secureCheck(found), headsetCheck(found), serverCheck(found), roleCheck(found)];
  if (!found.webgl) {
    checks.splice(2, 0, {
      name: "3D graphics",
      verdict: "missing",
      text: "The browser offers no WebGL 2. Switch graphics acceleration on in its settings.",
    });
  }
  return { checks, ready: checks.every(({ verdict }) => verdict === "ok" || verdict === "warning") };
}

/** @param {Found} found @returns {Check} */
function secureCheck({ secure }) {
  const name = "Secure connection";
  if (secure) return { name, verdict: "ok", text: "The page came over a connection that WebXR accepts." };
  return {
    name,
    verdict: "missing",
    text: "WebXR needs https. Run `mrnav tls --save` on the server, start it again, and open this page with https://.",
  };
}

/** @param {Found} found @returns {Check} */
function headsetCheck({ secure, webxr, immersion }) {
  const name = "Headset";
  if (immersion === "immersive-ar") return { name, verdict: "ok", text: "Mixed reality: you see your bench around the twin." };
  if (immersion === "immersive-vr") {
    return { name, verdict: "warning", text: "Virtual reality only: you will not see your bench. Keep clear of it." };
  }
  if (!secure) return { name, verdict: "missing", text: "Cannot be asked for over plain http." };
  const text = webxr
    ? "The browser knows WebXR, but finds no headset. Open this page in the headset's own browser."
    : "This browser does not know WebXR. Open this page in the headset's own browser.";
  return { name, verdict: "missing", text };
}

/** @param {Found} found @returns {Check} */
function serverCheck({ link, signedOut }) {
  const name = "Server";
  if (signedOut) {
    const text = "Not signed in. Open this page with the token that the server printed: /xr?token=…";
    return { name, verdict: "missing", text };
  }
  if (link === "open") return { name, verdict: "ok", text: "Connected." };
  return { name, verdict: "waiting", text: link === "lost" ? "Reconnecting…" : "Connecting…" };
}

/** @param {Found} found @returns {Check} */
function roleCheck({ role }) {
  const name = "Your role";
  if (role === null) return { name, verdict: "waiting", text: "Known once the server answers." };
  if (role === "operator") return { name, verdict: "ok", text: "Operator: your hand may steer." };
  return { name, verdict: "warning", text: "Viewer: you may look, and press STOP; your hand moves nothing." };
}

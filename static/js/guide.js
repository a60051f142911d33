/**
 * What this page may ask for now, and what the operator would do next. Plain functions of what is known.
 * @module
 */

/** @import { Ask, CriticalArea, Mode, Role, State } from "./types.js" */

/** @typedef {"take" | "arm" | "auto" | "manual" | "reset" | "steer" | null} NextButton */

/**
 * @typedef {object} Known
 * @property {Role} role
 * @property {string} session
 * @property {State} state
 * @property {CriticalArea | null} chosen
 * @property {boolean} fresh Whether the state is recent enough to act on.
 * @property {boolean} chief Whether this page may take control from another operator.
 * @property {boolean} elsewhere Whether another tab of this browser has control.
 */

/** @type {Record<Exclude<Ask, "stop">, Mode[]>} */
const MODES_FOR = {
  arm: ["DISARMED"],
  disarm: ["MANUAL", "AUTO", "HOLD"],
  manual: ["AUTO", "HOLD"],
  auto: ["MANUAL", "HOLD"],
  hold: ["MANUAL", "AUTO"],
  reset: ["FAULT", "STOP"],
};

/** Whether this page controls the rig. @param {Known} known */
export function hasControl({ role, session, state }) {
  return role === "operator" && state.lease.console === session;
}

/**
 * Whether an ask makes sense now. The server decides; this only keeps hopeless buttons from being pressed.
 * @param {Exclude<Ask, "stop">} ask
 * @param {Known} known
 * @returns {boolean}
 */
export function mayAsk(ask, known) {
  if (!known.fresh || !hasControl(known) || !MODES_FOR[ask].includes(known.state.mode)) return false;
  if (ask === "auto") return autoRefusal(known) === "";
  return ask !== "manual" || known.state.lease.hand;
}

/**
 * Why Auto cannot start now; "" if it can.
 * @param {Known} known
 * @returns {string}
 */
export function autoRefusal(known) {
  const { role, state, chosen } = known;
  if (role === "viewer") return "A viewer cannot start Auto.";
  if (!hasControl(known)) return "Take control first.";
  if (state.mode === "AUTO") return "";
  if (!MODES_FOR.auto.includes(state.mode)) {
    return state.mode === "DISARMED" ? "Arm first." : "Reset first.";
  }
  if (!chosen) return "Mark a critical area: click on the image.";
  return state.auto_ready ? "" : sentence(state.auto_refusal || "The server is not ready for Auto.");
}

/**
 * The next sensible step, as a sentence and as the button that takes it.
 * @param {Known} known
 * @returns {{text: string, button: NextButton}}
 */
export function nextStep(known) {
  const { role, state } = known;
  if (role === "viewer") return { text: "You are watching. Anyone may press STOP.", button: null };
  if (!hasControl(known)) {
    if (state.lease.console === null) return { text: "Take control to begin.", button: "take" };
    if (known.elsewhere) {
      return { text: "Another tab of this browser has control: go on there, or close it.", button: null };
    }
    const holder = state.lease.client || "Another page";
    const may = known.chief ? "has control. You may take it over: the rig rests first" : "has control and must give it back first";
    return { text: sentence(`${holder} ${may}`), button: null };
  }
  switch (state.mode) {
    case "DISARMED":
      return { text: "Arm to let the magnet move.", button: "arm" };
    case "FAULT":
      return { text: "Remove the cause, then reset. Reset leads to Disarmed.", button: "reset" };
    case "STOP":
      return { text: "Reset when it is safe to go on. Reset leads to Disarmed.", button: "reset" };
    case "AUTO":
      if (!state.lease.hand) return { text: "Choose Steer at any time, to be able to take over.", button: "steer" };
      return { text: "Close the clutch at any time to take over.", button: null };
    case "HOLD":
    case "MANUAL":
      return armedStep(known);
  }
}

/**
 * @param {Known} known
 * @returns {{text: string, button: NextButton}}
 */
function armedStep(known) {
  const { state, chosen } = known;
  if (state.mode === "MANUAL" && state.clutch) return { text: "The robot follows your hand.", button: null };
  const hand = state.lease.hand ? "Close the clutch to steer by hand" : "Choose Steer to drive from this page";
  if (!chosen) return { text: `${hand}. Mark a critical area to use Auto.`, button: null };
  if (autoRefusal(known) !== "") return { text: `${hand}.`, button: null };
  return { text: state.lease.hand ? `${hand}, or start Auto.` : `Start Auto. ${hand}.`, button: "auto" };
}

/**
 * A server's reason as a sentence.
 * @param {string} text
 * @returns {string}
 */
export function sentence(text) {
  const trimmed = text.trim();
  if (!trimmed) return "";
  const start = trimmed.charAt(0).toUpperCase() + trimmed.slice(1);
  return /[.!?]$/.test(start) ? start : `${start}.`;
}

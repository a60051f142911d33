/**
 * Numbers as people read them. Missing values are a dash, never 0.
 * @module
 */

/** @import { Percentiles, State } from "./types.js" */

export const MISSING = "–";

/**
 * @param {number | null | undefined} value
 * @param {number} digits
 * @returns {string}
 */
export function fixed(value, digits) {
  return value === null || value === undefined || !Number.isFinite(value) ? MISSING : value.toFixed(digits);
}

/**
 * A length as µm below 1 mm, as mm from there on.
 * @param {number | null | undefined} length_um
 * @returns {{value: string, unit: string}}
 */
export function length(length_um) {
  if (length_um === null || length_um === undefined || !Number.isFinite(length_um)) {
    return { value: MISSING, unit: "mm" };
  }
  if (Math.abs(length_um) < 1000) return { value: length_um.toFixed(0), unit: "µm" };
  return { value: (length_um / 1000).toFixed(2), unit: "mm" };
}

/**
 * A duration as minutes and seconds.
 * @param {number} duration_s
 * @returns {string}
 */
export function clock(duration_s) {
  const whole = Math.max(0, Math.floor(duration_s));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/**
 * How long the hand's samples take to become commands; null without a hand, where the server says 0.
 * @param {State} state
 * @returns {Percentiles | null}
 */
export function handLatency(state) {
  return state.rates_hz.hand > 0 ? (state.latency_ms.hand_to_command ?? null) : null;
}

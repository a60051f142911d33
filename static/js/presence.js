/**
 * Losing control, and coming back after nobody saw the page: said once, with what to do.
 * @module
 */

import { explain, request } from "./api.js";
import { hasControl } from "./guide.js";

/** @import { Messages } from "./messages.js" */
/** @import { Known } from "./guide.js" */

const LONG_MS = 500;
const BEAT_MS = 250;
/** The server keeps a silent seat for so long. */
const SEAT_KEPT_MS = 2000;

export class Presence {
  #messages;
  #had = false;
  #gaveBack = false;
  #reclaiming = false;
  /** The vessel that the server goes over to. */
  #expected = "";
  #why = "";
  #beat_ms = performance.now();
  #away_ms = 0;

  /** @param {Messages} messages */
  constructor(messages) {
    this.#messages = messages;
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.#beat_ms = performance.now();
      else this.#return();
    });
    // A computer that slept, or a page that was frozen, notices by its own clock.
    setInterval(() => {
      if (!document.hidden) this.#return();
    }, BEAT_MS);
  }

  /** The server says why a seat changed hands. @param {string} reason */
  explain(reason) {
    if (reason) this.#why = reason;
  }

  /** The link breaks, for the server goes over to another vessel. @param {string} vessel */
  expect(vessel) {
    this.#expected = vessel;
    this.#messages.say(`The server goes over to vessel ${vessel}: a moment`, "info");
  }

  /** The operator gives control back: no loss to be told. */
  giveBack() {
    this.#gaveBack = true;
  }

  /**
   * The link is back, under a new session: a seat that the old one still has comes along.
   * @param {string} session The old one's secret.
   * @param {number} silent_ms For how long nothing came.
   * @param {string} vessel Which one the server goes by.
   */
  async reconnected(session, silent_ms, vessel) {
    const changed = this.#expected !== "" && this.#expected === vessel;
    this.#expected = "";
    if (changed) this.#messages.say(`Vessel ${vessel} is in use: see that its outline lies where the vessel does`, "info");
    if (!this.#had || (silent_ms > SEAT_KEPT_MS && !changed)) return;
    this.#reclaiming = true;
    try {
      await request("DELETE", "/lease", undefined, { as: session });
      await request("POST", "/lease", { client: "dashboard" });
      if (!changed) {
        this.#messages.say("The connection was lost and is back: you are still in control, and the rig holds", "info");
      }
    } catch (error) {
      this.#why = explain(error);
    }
    this.#reclaiming = false;
  }

  /** @param {Known} known */
  show(known) {
    if (!known.fresh || this.#reclaiming) return;
    const has = hasControl(known);
    if (this.#had && !has && !this.#gaveBack) this.#tellLoss();
    if (has) this.#why = "";
    this.#gaveBack &&= has;
    this.#had = has;
  }

  #tellLoss() {
    const away = this.#away_ms > 0 ? `Nobody saw this page for ${Math.round(this.#away_ms / 1000)} s` : "";
    const why = away || this.#why || "This page was not heard for 2 s";
    this.#messages.say(`You lost control: ${why}. The rig holds. Take control again to go on`, "warning");
    this.#away_ms = 0;
  }

  #return() {
    const now_ms = performance.now();
    const silent_ms = now_ms - this.#beat_ms - BEAT_MS;
    this.#beat_ms = now_ms;
    if (silent_ms > LONG_MS) this.#away_ms = silent_ms;
  }
}

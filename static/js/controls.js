/**
 * Mode, control of the rig, and the buttons that ask for a mode.
 * @module
 */

import { explain, request } from "./api.js";
import { byId, setText } from "./dom.js";
import { autoRefusal, hasControl, mayAsk, nextStep, sentence } from "./guide.js";

/** @import { Answer, Ask, Mode, Severity, State } from "./types.js" */
/** @import { Known } from "./guide.js" */
/** @import { Messages } from "./messages.js" */

/** @type {Record<Mode, string>} */
const MODE_MEANS = {
  DISARMED: "Nothing moves the magnet",
  MANUAL: "Your hand moves the magnet while the clutch is closed",
  AUTO: "The policy moves the magnet",
  HOLD: "Held at rest until you act",
  FAULT: "Latched until reset",
  STOP: "The manipulator was stopped; latched until reset",
};

/** @type {Record<Severity, string>} */
const SEVERITY_MEANS = {
  NONE: "Normal",
  WARN: "Warning",
  HOLD: "Held",
  FAULT: "Fault",
  STOP: "Stopped",
};

/** @typedef {Exclude<Ask, "stop">} ButtonAsk */

export class Controls {
  #mode = byId("mode", HTMLElement);
  #modeCard = byId("mode-card", HTMLElement);
  #modeMeans = byId("mode-means", HTMLElement);
  #reason = byId("reason", HTMLElement);
  #severity = byId("severity", HTMLElement);
  #authority = byId("authority", HTMLElement);
  #authorityText = byId("authority-text", HTMLElement);
  #lease = byId("lease", HTMLElement);
  #hand = byId("hand", HTMLElement);
  #clutch = byId("clutch", HTMLElement);
  #next = byId("next-step", HTMLElement);
  #refusal = byId("auto-refusal", HTMLElement);
  #autoArea = byId("auto-area", HTMLElement);
  #take = byId("take", HTMLButtonElement);
  #give = byId("give", HTMLButtonElement);
  #force = byId("force", HTMLButtonElement);
  #why = byId("lease-why", HTMLElement);
  #learned = byId("learned", HTMLElement);
  /** @type {Record<ButtonAsk, HTMLButtonElement>} */ #buttons;
  #messages;
  #onGive;

  /**
   * @param {(ask: Ask, area?: string) => Promise<Answer>} ask
   * @param {() => string | undefined} chosenArea
   * @param {Messages} messages
   * @param {() => void} onGive Control is being given back.
   */
  constructor(ask, chosenArea, messages, onGive) {
    this.#messages = messages;
    this.#onGive = onGive;
    /** @param {ButtonAsk} name */
    const button = (name) => {
      const element = byId(name, HTMLButtonElement);
      element.addEventListener("click", async () => {
        const answer = await ask(name, name === "auto" ? chosenArea() : undefined);
        if (answer.ok) messages.clear();
        else messages.say(answer.message, "warning");
      });
      return element;
    };
    this.#buttons = {
      arm: button("arm"),
      disarm: button("disarm"),
      manual: button("manual"),
      auto: button("auto"),
      hold: button("hold"),
      reset: button("reset"),
    };
    this.#take.addEventListener("click", () => this.#changeLease("POST"));
    this.#force.addEventListener("click", () => this.#changeLease("POST", true));
    this.#give.addEventListener("click", () => {
      this.#onGive();
      void this.#changeLease("DELETE");
    });
  }

  /** Show what is known. @param {Known} known */
  show(known) {
    this.#showMode(known.state);
    this.#showLease(known);
    const { text, button: next } = nextStep(known);
    setText(this.#next, text);
    for (const [name, element] of Object.entries(this.#buttons)) {
      element.disabled = !mayAsk(/** @type {ButtonAsk} */ (name), known);
      element.dataset.next = String(name === next);
    }
    setText(this.#autoArea, known.chosen ? ` to ${known.chosen.label || known.chosen.id}` : "");
    const refusal = autoRefusal(known);
    setText(this.#refusal, refusal && `No Auto: ${refusal.charAt(0).toLowerCase()}${refusal.slice(1)}`);
    this.#showLearned(known.state);
  }

  /** Why a seat changed hands. @param {string} reason */
  explainLease(reason) {
    setText(this.#why, sentence(reason));
  }

  /** What autonomy has found out about magnet and robot. @param {State} state */
  #showLearned({ learned }) {
    const [x, y] = learned.offset_um;
    const text = `offset ${x.toFixed(0)}, ${y.toFixed(0)} µm; lead ${learned.friction_lead_um.toFixed(0)} µm`;
    setText(this.#learned, learned.looks > 0 ? text : "nothing yet");
  }

  /** @param {State} state */
  #showMode(state) {
    setText(this.#mode, state.mode);
    this.#modeCard.dataset.mode = state.mode;
    this.#modeCard.dataset.severity = state.severity;
    setText(this.#modeMeans, state.reason ? "" : MODE_MEANS[state.mode]);
    setText(this.#reason, sentence(state.reason));
    setText(this.#severity, SEVERITY_MEANS[state.severity]);
    const hand_percent = Math.round(state.authority * 100);
    this.#authority.style.setProperty("--hand-share", `${hand_percent}%`);
    const moving = state.mode === "MANUAL" || state.mode === "AUTO";
    this.#authority.dataset.idle = String(!moving);
    setText(
      this.#authorityText,
      moving ? `Hand ${hand_percent} %, policy ${100 - hand_percent} %` : "Nobody moves the magnet",
    );
  }

  /** @param {Known} known */
  #showLease(known) {
    const { role, state, fresh } = known;
    const mine = hasControl(known);
    const free = state.lease.console === null;
    setText(this.#lease, mine ? "You" : free ? "Nobody" : state.lease.client || "Another page");
    this.#take.disabled = !fresh || role === "viewer" || !free;
    this.#give.disabled = !fresh || !mine;
    this.#take.hidden = mine || (known.chief && !free);
    this.#force.hidden = mine || free || !known.chief;
    this.#force.disabled = !fresh;
    this.#give.hidden = !mine;
    this.#take.dataset.next = String(nextStep(known).button === "take");
    setText(this.#hand, state.lease.hand ? "Live" : "None");
    this.#hand.dataset.on = String(state.lease.hand);
    setText(this.#clutch, state.clutch ? "Closed" : "Open");
    this.#clutch.dataset.on = String(state.clutch);
  }

  /** @param {"POST" | "DELETE"} method @param {boolean} [force] Take it from whoever has it. */
  async #changeLease(method, force = false) {
    try {
      await request(method, "/lease", method === "POST" ? { client: force ? "the chief" : "dashboard", force } : undefined);
      this.#messages.clear();
    } catch (error) {
      this.#messages.say(explain(error), "warning");
    }
  }
}

/**
 * Plays a recorded trial back: one moment, shown by map, charts, film and time line.
 * @module
 */

import { ApiError, explain, request } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { fixed } from "./format.js";
import { COLORS } from "./marks.js";
import { PlaybackChart } from "./playback-chart.js";
import { Film } from "./playback-film.js";
import { SIGNS, TimeLine } from "./playback-line.js";
import { PlaybackMap } from "./playback-map.js";
import { inForce, indexAt } from "./playback-time.js";
import { CONDITIONS, kindOf } from "./results-trial.js";

/** @import { Playback } from "./playback-types.js" */

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
const PATIENCE_MS = 30_000;

class Player {
  #trial;
  #map;
  #line;
  #charts;
  #film;
  #play = byId("play", HTMLButtonElement);
  #events;
  #speed = 1;
  #at_s;
  #begin_s;
  #end_s;
  #playing = false;
  #before_ms = 0;

  /** @param {Playback} trial */
  constructor(trial) {
    this.#trial = trial;
    const { t_s, distance_um, speed_um_per_s, jerk_um_per_s3 } = trial.frames;
    this.#begin_s = this.#at_s = t_s[0] ?? 0;
    this.#end_s = t_s.at(-1) ?? 0;
    /** @param {number} at_s */
    const seek = (at_s) => this.#seek(at_s);
    this.#map = new PlaybackMap(byId("map", HTMLCanvasElement), trial);
    this.#line = new TimeLine(byId("line", HTMLCanvasElement), trial, seek);
    /** @param {string} id @param {(number | null)[]} values @param {number} unit @param {string} color */
    const chart = (id, values, unit, color) =>
      new PlaybackChart(byId(id, HTMLElement), t_s, values.map((value) => (value === null ? null : value / unit)), color, seek);
    this.#charts = [
      chart("chart-distance", distance_um, 1000, COLORS.area),
      chart("chart-speed", speed_um_per_s, 1, COLORS.robot),
      chart("chart-jerk", jerk_um_per_s3, 1000, COLORS.robot),
    ];
    byId("film", HTMLElement).hidden = trial.film_s.length === 0;
    this.#film = trial.film_s.length > 0 ? new Film(byId("film-picture", HTMLImageElement), trial.id, trial.film_s) : null;
    this.#events = trial.marks.map(({ t_s: at_s, kind, text }) => {
      const button = make("button", { type: "button" }, make("i", { "aria-hidden": "true" }, SIGNS[kind].sign), make("time", {}, `${seconds(at_s)} s`), text.charAt(0).toUpperCase() + text.slice(1));
      button.addEventListener("click", () => this.#seek(at_s));
      return make("li", { "data-kind": kind }, button);
    });
    byId("events", HTMLElement).replaceChildren(...this.#events);
    const speeds = SPEEDS.map((speed) => {
      const button = make("button", { type: "button", "aria-pressed": String(speed === 1), "data-testid": `speed-${speed}` }, `${speed}×`);
      button.addEventListener("click", () => {
        this.#speed = speed;
        for (const each of speeds) each.setAttribute("aria-pressed", String(each === button));
      });
      return button;
    });
    byId("speeds", HTMLElement).replaceChildren(...speeds);
    this.#play.addEventListener("click", () => this.#toggle());
    document.addEventListener("keydown", (event) => this.#key(event));
    this.#show();
  }

  #toggle() {
    this.#playing = !this.#playing;
    if (this.#playing && this.#at_s >= this.#end_s - 1e-6) this.#at_s = this.#begin_s;
    this.#before_ms = performance.now();
    this.#showPlaying();
    if (this.#playing) requestAnimationFrame((now_ms) => this.#advance(now_ms));
  }

  /** @param {number} now_ms */
  #advance(now_ms) {
    if (!this.#playing) return;
    this.#at_s = Math.min(this.#end_s, this.#at_s + (this.#speed * Math.max(0, now_ms - this.#before_ms)) / 1000);
    this.#before_ms = now_ms;
    this.#playing = this.#at_s < this.#end_s;
    this.#show();
    if (this.#playing) requestAnimationFrame((next_ms) => this.#advance(next_ms));
    else this.#showPlaying();
  }

  /** @param {number} at_s */
  #seek(at_s) {
    this.#at_s = Math.min(Math.max(at_s, this.#begin_s), this.#end_s);
    this.#before_ms = performance.now();
    this.#show();
  }

  /** @param {number} count Of tracks, forwards or backwards. */
  #step(count) {
    const { t_s } = this.#trial.frames;
    const next = Math.min(Math.max(indexAt(t_s, this.#at_s) + count, 0), t_s.length - 1);
    this.#playing = false;
    this.#showPlaying();
    this.#seek(t_s[next] ?? this.#begin_s);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (direction !== undefined && event.shiftKey) this.#seek(this.#at_s + direction);
    else if (direction !== undefined) this.#step(direction);
    else if (event.key === "Home") this.#seek(this.#begin_s);
    else if (event.key === "End") this.#seek(this.#end_s);
    // A button that has the focus is pressed by the space bar as everywhere.
    else if (event.key === " " && !(event.target instanceof HTMLButtonElement)) this.#toggle();
    else return;
    event.preventDefault();
  }

  #showPlaying() {
    this.#play.setAttribute("aria-pressed", String(this.#playing));
    setText(byId("play-text", HTMLElement), this.#playing ? "Pause" : "Play");
    this.#play.querySelector("use")?.setAttribute("href", this.#playing ? "#i-pause" : "#i-play");
  }

  #show() {
    const { frames, modes } = this.#trial;
    const at_s = this.#at_s;
    const i = indexAt(frames.t_s, at_s);
    const now = inForce(modes, at_s);
    const mode = now?.mode || "not known";
    this.#map.show(at_s, i);
    this.#line.show(at_s, mode);
    this.#film?.show(at_s);
    for (const chart of this.#charts) chart.show(at_s);
    setText(byId("clock", HTMLElement), `${seconds(at_s)} s of ${seconds(this.#end_s)} s`);
    setText(byId("now-mode", HTMLElement), mode);
    const hand = frames.hand[i];
    setText(byId("now-hand", HTMLElement), typeof hand === "number" ? `${Math.round(100 * hand)} %` : "shared");
    setText(byId("now-clutch", HTMLElement), frames.clutch[i] ? "Closed" : "Open");
    setText(byId("now-frame", HTMLElement), String(frames.number[i] ?? "–"));
    /** @param {(number | null)[]} column @param {number} unit */
    const value = (column, unit) => (typeof column[i] === "number" ? (column[i] ?? 0) / unit : null);
    setText(byId("now-distance", HTMLElement), fixed(value(frames.distance_um, 1000), 2));
    setText(byId("now-speed", HTMLElement), fixed(value(frames.speed_um_per_s, 1), 0));
    setText(byId("now-jerk", HTMLElement), fixed(value(frames.jerk_um_per_s3, 1000), 0));
    const current = this.#line.eventAt(at_s);
    this.#events.forEach((event, k) => {
      if (k === current) event.setAttribute("aria-current", "true");
      else event.removeAttribute("aria-current");
    });
  }
}

/** Without a minus before zero. @param {number} at_s */
function seconds(at_s) {
  return (Math.round(100 * at_s) / 100 + 0).toFixed(2);
}

async function start() {
  const id = new URLSearchParams(location.search).get("trial") ?? "";
  const main = /** @type {HTMLElement} */ (document.querySelector("main"));
  const note = byId("note", HTMLElement);
  if (!id) {
    setText(note, "Which trial? Choose one in the results.");
    return;
  }
  byId("to-results", HTMLAnchorElement).href = `/results?trial=${encodeURIComponent(id)}`;
  try {
    const path = `/trials/${encodeURIComponent(id)}/playback`;
    const trial = /** @type {Playback} */ (await request("GET", path, undefined, { timeout_ms: PATIENCE_MS }));
    byId("simulated", HTMLElement).hidden = !trial.simulated;
    const who = trial.operator_kind === "simulated" ? `simulated operator ${trial.participant}` : trial.participant;
    const state = trial.status === "interrupted" ? "interrupted" : "";
    setText(byId("about", HTMLElement), [who, CONDITIONS[trial.condition], trial.vessel, state, kindOf(trial)].filter(Boolean).join(" · "));
    if (trial.frames.t_s.length === 0) {
      setText(note, "This trial holds no picture of the robot: there is nothing to play.");
      return;
    }
    main.dataset.state = "ready";
    new Player(trial);
  } catch (error) {
    const signedOut = error instanceof ApiError && error.status === 401;
    setText(note, signedOut ? "Not signed in. Open the address with the token that the server printed." : explain(error));
  }
}

void start();

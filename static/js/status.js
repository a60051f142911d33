/**
 * The figures below the picture, and the status line.
 * @module
 */

import { byId, setText } from "./dom.js";
import { fixed, handLatency, length, MISSING } from "./format.js";

/** @import { State } from "./types.js" */
/** @import { Link } from "./socket.js" */

/** @type {Record<Link, string>} */
const LINK_MEANS = { connecting: "connecting", open: "connected", lost: "reconnecting" };

const TRACK_MEANS = { searching: "Searching", acquiring: "Acquiring", tracking: "Tracking" };

export class Status {
  /** @type {Map<string, HTMLElement>} */ #cells = new Map();

  /** @param {string} id @param {string} text */
  #put(id, text) {
    const cell = this.#cells.get(id) ?? byId(id, HTMLElement);
    this.#cells.set(id, cell);
    setText(cell, text);
    return cell;
  }

  /** The operator's figures. @param {State} state */
  showFigures(state) {
    const distance = length(state.distance_um);
    this.#put("figure-distance", distance.value);
    this.#put("figure-distance-unit", distance.unit);
    const lead = length(state.lead_um);
    this.#put("figure-lead", lead.value);
    this.#put("figure-lead-unit", lead.value === MISSING ? "µm" : lead.unit);
    this.#put("figure-handover", fixed(state.time_to_handover_s, 1));
    this.#put("figure-track", TRACK_MEANS[state.track.state]).dataset.warning = String(
      state.track.state !== "tracking",
    );
    this.#put("figure-confidence", fixed(state.track.confidence * 100, 0));
    this.#put("figure-collisions", String(state.collisions));
  }

  /** Rates and latencies. @param {State} state */
  showRates(state) {
    const { rates_hz, latency_ms } = state;
    this.#put("status-camera", `${fixed(rates_hz.camera, 0)} fps`);
    this.#put("status-hand", `${fixed(rates_hz.hand, 0)} Hz`);
    this.#put("status-poses", `${fixed(rates_hz.hand_poses, 0)} Hz`);
    this.#put("status-tick", `${fixed(latency_ms.tick?.p99, 1)} ms`);
    this.#put("status-confidence", `${fixed(state.track.confidence * 100, 0)} %`);
    this.#put("status-collisions", String(state.collisions));
    this.#put("status-trial", state.trial ?? "none");
    const latency = handLatency(state);
    this.#put("latency-hand", `${fixed(latency?.p50, 1)} / ${fixed(latency?.p99, 1)}`);
    const twin = latency_ms.frame_to_twin;
    this.#put("latency-frame", `${fixed(twin?.p50, 0)} / ${fixed(twin?.p99, 0)}`);
  }

  /**
   * State of the links.
   * @param {Link} twin
   * @param {Link} video
   * @param {number} video_fps
   */
  showLinks(twin, video, video_fps) {
    this.#put("status-twin", LINK_MEANS[twin]).dataset.link = twin;
    const text = video === "open" ? `${fixed(video_fps, 0)} fps` : LINK_MEANS[video];
    this.#put("status-video", text).dataset.link = video === "open" && video_fps === 0 ? "lost" : video;
  }
}

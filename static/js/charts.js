/**
 * Live charts of the last minute.
 * @module
 */

import uPlot from "/static/vendor/uplot/uPlot.esm.js";
import { byId } from "./dom.js";
import { handLatency } from "./format.js";
import { COLORS } from "./marks.js";

/** @import { State } from "./types.js" */

const WINDOW_S = 60;
const SAMPLE_S = 0.2;
const KEPT = Math.ceil(WINDOW_S / SAMPLE_S) + 1;
const MARKS_S = [-45, -30, -15, 0];
const FONT = "11px system-ui, sans-serif";

/**
 * @typedef {object} Line
 * @property {string} name
 * @property {string} color
 * @property {boolean} [dashed]
 * @property {(state: State) => number | null} read
 */

class Chart {
  #lines;
  #plot;
  /** Times, then one row a line. @type {(number | null)[][]} */ #rows;

  /**
   * @param {HTMLElement} host
   * @param {Line[]} lines
   * @param {number} least_max The scale shows at least this much.
   */
  constructor(host, lines, least_max) {
    this.#lines = lines;
    this.#rows = [[], ...lines.map(() => [])];
    const size = () => ({ width: Math.max(host.clientWidth, 80), height: Math.max(host.clientHeight, 60) });
    /** @type {uPlot.Axis} */
    const axis = {
      stroke: COLORS.muted,
      font: FONT,
      grid: { stroke: COLORS.line, width: 1 },
      ticks: { show: false },
    };
    this.#plot = new uPlot(
      {
        ...size(),
        padding: [8, 16, 0, 0],
        cursor: { show: false },
        legend: { show: false },
        scales: {
          x: { time: false, range: (_plot, _min, max) => [max - WINDOW_S, max] },
          y: { range: (_plot, _min, max) => [0, Math.max(least_max, (max || 0) * 1.15)] },
        },
        axes: [
          {
            ...axis,
            size: 20,
            gap: 2,
            splits: (_plot, _axis, _min, max) => MARKS_S.map((mark_s) => max + mark_s),
            values: () => MARKS_S.map((mark_s) => (mark_s === 0 ? "now" : `${mark_s} s`)),
          },
          { ...axis, size: 40, gap: 4, space: 24 },
        ],
        series: [
          {},
          ...lines.map((line) => ({
            stroke: line.color,
            width: 1.5,
            points: { show: false },
            ...(line.dashed ? { dash: [4, 4] } : {}),
          })),
        ],
      },
      /** @type {uPlot.AlignedData} */ (/** @type {unknown} */ (this.#rows)),
      host,
    );
    new ResizeObserver(() => this.#plot.setSize(size())).observe(host);
  }

  /**
   * @param {number} at_s
   * @param {State | null} state Null leaves a gap: no data is not zero.
   */
  add(at_s, state) {
    const values = [at_s, ...this.#lines.map((line) => (state ? line.read(state) : null))];
    this.#rows.forEach((row, i) => {
      row.push(values[i] ?? null);
      if (row.length > KEPT) row.shift();
    });
    this.#plot.setData(/** @type {uPlot.AlignedData} */ (/** @type {unknown} */ (this.#rows)));
  }
}

export class Charts {
  #charts;
  #last_s = -Infinity;

  constructor() {
    /** @param {string} id */
    const host = (id) => byId(id, HTMLElement);
    this.#charts = [
      new Chart(
        host("chart-latency"),
        [
          { name: "hand p50", color: COLORS.hand, read: (s) => handLatency(s)?.p50 ?? null },
          {
            name: "hand p99",
            color: COLORS.hand,
            dashed: true,
            read: (s) => handLatency(s)?.p99 ?? null,
          },
          { name: "frame p50", color: COLORS.camera, read: (s) => s.latency_ms.frame_to_twin?.p50 ?? null },
          {
            name: "frame p99",
            color: COLORS.camera,
            dashed: true,
            read: (s) => s.latency_ms.frame_to_twin?.p99 ?? null,
          },
        ],
        20,
      ),
      new Chart(
        host("chart-distance"),
        [
          {
            name: "distance",
            color: COLORS.area,
            read: (s) => (s.distance_um === null ? null : s.distance_um / 1000),
          },
        ],
        1,
      ),
      new Chart(host("chart-lead"), [{ name: "lead", color: COLORS.tip, read: (s) => s.lead_um }], 200),
      new Chart(
        host("chart-confidence"),
        [{ name: "confidence", color: COLORS.robot, read: (s) => 100 * s.track.confidence }],
        100,
      ),
      new Chart(
        host("chart-rates"),
        [
          { name: "hand", color: COLORS.hand, read: (s) => s.rates_hz.hand ?? null },
          { name: "poses", color: COLORS.hand, dashed: true, read: (s) => s.rates_hz.hand_poses ?? null },
          { name: "camera", color: COLORS.camera, read: (s) => s.rates_hz.camera ?? null },
        ],
        60,
      ),
    ];
  }

  /**
   * Add a sample if it is time for one.
   * @param {number} at_s The page's clock.
   * @param {State | null} state
   */
  add(at_s, state) {
    if (at_s - this.#last_s < SAMPLE_S * 0.9) return;
    this.#last_s = at_s;
    for (const chart of this.#charts) chart.add(at_s, state);
  }
}

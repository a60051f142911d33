/**
 * A trial's speed over time; who points at it sees where the robot was.
 * @module
 */

import uPlot from "/static/vendor/uplot/uPlot.esm.js";
import { COLORS } from "./marks.js";

/** @import { Trajectory } from "./results-types.js" */

const FONT = "11px system-ui, sans-serif";
const LEAST_MAX = 500;

export class SpeedChart {
  #host;
  #onPoint;
  /** @type {uPlot | null} */ #plot = null;

  /** @param {HTMLElement} host @param {(at_s: number | null) => void} onPoint */
  constructor(host, onPoint) {
    this.#host = host;
    this.#onPoint = onPoint;
    new ResizeObserver(() => this.#plot?.setSize(this.#size())).observe(host);
  }

  #size() {
    return { width: Math.max(this.#host.clientWidth, 80), height: Math.max(this.#host.clientHeight, 80) };
  }

  /** @param {Trajectory | null} trajectory */
  show(trajectory) {
    this.#plot?.destroy();
    this.#plot = trajectory ? new uPlot(this.#options(), columns(trajectory), this.#host) : null;
  }

  /** @returns {uPlot.Options} */
  #options() {
    const axis = { stroke: COLORS.muted, font: FONT, grid: { stroke: COLORS.line, width: 1 }, ticks: { show: false } };
    /** @param {string} label @param {string} stroke @param {number[]} [dash] @returns {uPlot.Series} */
    const line = (label, stroke, dash) => ({
      label,
      stroke,
      width: 1.75,
      points: { show: false },
      ...(dash ? { dash } : {}),
    });
    return {
      ...this.#size(),
      padding: [8, 12, 0, 0],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false } },
      scales: {
        x: { time: false },
        y: { range: (_plot, _min, max) => [0, Math.max(LEAST_MAX, (max || 0) * 1.1)] },
      },
      axes: [
        { ...axis, size: 22, gap: 3 },
        { ...axis, size: 44, gap: 4, space: 32 },
      ],
      series: [{}, line("autonomy", COLORS.path), line("operator", COLORS.hand, [6, 3]), line("held", COLORS.camera, [2, 3])],
      hooks: {
        setCursor: [
          (plot) => {
            const at = plot.cursor.idx;
            this.#onPoint(at === null || at === undefined ? null : (plot.data[0][at] ?? null));
          },
        ],
      },
    };
  }
}

/**
 * Time, and one column a driver; a gap of the path is a gap of the lines.
 * @param {Trajectory} trajectory
 * @returns {uPlot.AlignedData}
 */
function columns({ parts }) {
  /** @type {[number[], (number | null)[], (number | null)[], (number | null)[]]} */
  const table = [[], [], [], []];
  for (const { t_s, speed_um_per_s, mode } of parts) {
    t_s.forEach((t, i) => {
      const driver = column(mode[i]);
      // The sample at which the driver changes belongs to both, so that the lines meet.
      const next = column(mode[i + 1] ?? mode[i]);
      table[0].push(t);
      for (const k of /** @type {const} */ ([1, 2, 3])) {
        table[k].push(k === driver || k === next ? (speed_um_per_s[i] ?? null) : null);
      }
    });
    const end_s = t_s.at(-1);
    if (end_s === undefined) continue;
    table[0].push(end_s + 1e-3);
    for (const k of /** @type {const} */ ([1, 2, 3])) table[k].push(null);
  }
  return table;
}

/** @param {string | undefined} mode */
function column(mode) {
  return mode === "AUTO" ? 1 : mode === "MANUAL" ? 2 : 3;
}

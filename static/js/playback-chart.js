/**
 * One measured figure of a recorded trial over time, with a head at the moment that is shown.
 * @module
 */

import uPlot from "/static/vendor/uplot/uPlot.esm.js";
import { COLORS } from "./marks.js";

const FONT = "11px system-ui, sans-serif";

export class PlaybackChart {
  #plot;
  #head;
  #at_s = 0;

  /**
   * @param {HTMLElement} host
   * @param {number[]} t_s
   * @param {(number | null)[]} values
   * @param {string} stroke
   * @param {(at_s: number) => void} onSeek
   */
  constructor(host, t_s, values, stroke, onSeek) {
    const size = () => ({ width: Math.max(host.clientWidth, 80), height: Math.max(host.clientHeight, 48) });
    const axis = { stroke: COLORS.muted, font: FONT, grid: { stroke: COLORS.line, width: 1 }, ticks: { show: false } };
    this.#plot = new uPlot(
      {
        ...size(),
        padding: [6, 12, 0, 0],
        legend: { show: false },
        cursor: { show: false },
        scales: { x: { time: false }, y: { range: (_plot, _min, max) => [0, (max || 1) * 1.1] } },
        axes: [
          { ...axis, size: 20, gap: 2 },
          { ...axis, size: 44, gap: 4, space: 24 },
        ],
        series: [{}, { stroke, width: 1.75, points: { show: false } }],
      },
      [t_s, values],
      host,
    );
    this.#head = host.appendChild(document.createElement("div"));
    this.#head.className = "head";
    new ResizeObserver(() => {
      this.#plot.setSize(size());
      this.show(this.#at_s);
    }).observe(host);
    /** @param {PointerEvent} event */
    const seek = (event) => {
      const box = this.#plot.over.getBoundingClientRect();
      onSeek(this.#plot.posToVal(Math.min(Math.max(event.clientX - box.left, 0), box.width), "x"));
    };
    host.addEventListener("pointerdown", (event) => {
      host.setPointerCapture(event.pointerId);
      seek(event);
    });
    host.addEventListener("pointermove", (event) => {
      if (host.hasPointerCapture(event.pointerId)) seek(event);
    });
  }

  /** @param {number} at_s */
  show(at_s) {
    this.#at_s = at_s;
    const left = this.#plot.over.offsetLeft + this.#plot.valToPos(at_s, "x");
    this.#head.style.transform = `translateX(${left}px)`;
  }
}

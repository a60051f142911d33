/**
 * The six scales of 21 marks. No mark is set beforehand, and no number is shown.
 * @module
 */

import { byId, make } from "./dom.js";

/** @import { Scale } from "./tlx-pairs.js" */

const LARGEST = 100;

export class Scales {
  #form = byId("scales", HTMLFormElement);
  #keys;

  /**
   * @param {Scale[]} scales
   * @param {number} step From mark to mark.
   * @param {Record<string, number>} ratings Marks set before.
   * @param {() => void} onChange
   */
  constructor(scales, step, ratings, onChange) {
    this.#keys = scales.map((scale) => scale.key);
    this.#form.replaceChildren(...scales.map((scale) => field(scale, step, ratings[scale.key])));
    this.#form.addEventListener("submit", (event) => event.preventDefault());
    this.#form.addEventListener("change", (event) => {
      if (event.target instanceof HTMLElement) event.target.closest("fieldset")?.removeAttribute("data-missing");
      onChange();
    });
  }

  /** The marks that are set. @returns {Record<string, number>} */
  get ratings() {
    const set = new FormData(this.#form);
    return Object.fromEntries(this.#keys.filter((key) => set.has(key)).map((key) => [key, Number(set.get(key))]));
  }

  /** Point at the scales without a mark; tell how many there are. */
  showMissing() {
    const ratings = this.ratings;
    const missing = [...this.#form.querySelectorAll("fieldset")].filter(({ name }) => !(name in ratings));
    for (const each of missing) each.dataset.missing = "true";
    missing[0]?.querySelector("input")?.focus();
    missing[0]?.scrollIntoView({ block: "center" });
    return missing.length;
  }
}

/** @param {Scale} scale @param {number} step @param {number | undefined} rating */
function field(scale, step, rating) {
  const marks = Array.from({ length: LARGEST / step + 1 }, (_, i) => {
    const input = make("input", {
      type: "radio",
      name: scale.key,
      value: String(i * step),
      "aria-label": `${scale.title}, ${i + 1} of ${LARGEST / step + 1} from ${scale.low} to ${scale.high}`,
      "data-testid": `${scale.key}-${i * step}`,
    });
    input.checked = rating === i * step;
    return make("label", {}, input, make("i"));
  });
  return make(
    "fieldset",
    { class: "scale", name: scale.key, "data-testid": `scale-${scale.key}` },
    make("legend", {}, make("h3", {}, scale.title)),
    make("p", {}, scale.question),
    make("div", { class: "marks" }, ...marks),
    make("div", { class: "ends", "aria-hidden": "true" }, make("span", {}, scale.low), make("span", {}, scale.high)),
  );
}

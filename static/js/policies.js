/**
 * The policies of this vessel: which one would drive, and how another one is trained.
 * @module
 */

import { byId, make, setText } from "./dom.js";

/** @import { Snapshot } from "./types.js" */

export class Policies {
  #list = byId("policies", HTMLUListElement);
  #train = byId("train-command", HTMLElement);

  /** @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#list.replaceChildren(
      ...snapshot.policies.map(({ name, kind, verified, reason }) =>
        make(
          "li",
          {},
          make("b", {}, name),
          make("span", { class: "hint" }, ` ${kind}, ${verified ? "✓ verified for this vessel" : `not usable: ${reason}`}`),
        ),
      ),
    );
    setText(this.#train, `mrnav train ${snapshot.vessel.name}`);
  }
}

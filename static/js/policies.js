/**
 * The policies of this vessel: which one would drive, and how another one is trained.
 * @module
 */

import { request } from "./api.js";
import { byId, make, setText } from "./dom.js";

/** @import { Policy, Snapshot } from "./types.js" */

export class Policies {
  #list = byId("policies", HTMLUListElement);
  #train = byId("train-command", HTMLElement);

  /** @param {Snapshot} snapshot */
  reset(snapshot) {
    this.#show(snapshot.policies);
    setText(this.#train, `mrnav train ${snapshot.vessel.name}`);
  }

  /** Ask again: another policy may drive. */
  async refresh() {
    try {
      this.#show(/** @type {Policy[]} */ (await request("GET", "/policies")));
    } catch {
      // The next snapshot names them.
    }
  }

  /** @param {Policy[]} policies */
  #show(policies) {
    this.#list.replaceChildren(
      ...policies.map(({ name, kind, verified, reason }) =>
        make(
          "li",
          {},
          make("b", {}, name),
          make("span", { class: "hint" }, ` ${kind}, ${verified ? "✓ verified for this vessel" : `not usable: ${reason}`}`),
        ),
      ),
    );
  }
}

/** The fleet at a glance: one line per vehicle, with a button that shows it. */

import { duration, figure, look, make, put, quietLink, UNKNOWN } from "./words.js";

export class FleetTable {
  /** @param {HTMLTableElement} table @param {(vehicle: string) => void} see */
  constructor(table, see) {
    this.body = table.tBodies[0];
    this.see = see;
    /** @type {Map<string, HTMLTableRowElement>} */
    this.lines = new Map();
  }

  /** @param {any[]} fleet in order @param {string} shown */
  show(fleet, shown) {
    const names = fleet.map((seen) => seen.vehicle);
    if (names.join("/") !== [...this.lines.keys()].join("/")) this.#arrange(names);
    for (const seen of fleet) this.#line(seen, seen.vehicle === shown);
  }

  /** @param {string[]} names */
  #arrange(names) {
    const lines = names.map((name) => /** @type {[string, HTMLTableRowElement]} */ ([name, this.lines.get(name) ?? this.#make(name)]));
    const focused = document.activeElement;
    this.lines = new Map(lines);
    this.body.replaceChildren(...lines.map(([, line]) => line));
    if (focused instanceof HTMLElement && this.body.contains(focused)) focused.focus();
  }

  /** @param {string} name */
  #make(name) {
    const line = /** @type {HTMLTableRowElement} */ (make("tr"));
    const head = make("th");
    head.setAttribute("scope", "row");
    const button = make("button", "", name);
    head.append(button);
    const state = make("td", "state");
    state.append(make("span", "glyph"), make("span"));
    state.firstElementChild?.setAttribute("aria-hidden", "true");
    line.append(head, state, make("td"), make("td", "number"), make("td", "number"));
    line.dataset.vehicle = name;
    line.onclick = () => this.see(name);
    return line;
  }

  /** @param {any} seen @param {boolean} shown */
  #line(seen, shown) {
    const line = /** @type {HTMLTableRowElement} */ (this.lines.get(seen.vehicle));
    const { tone, glyph, word } = look(seen);
    line.dataset.contact = seen.contact;
    line.dataset.tone = tone;
    line.classList.toggle("shown", shown);
    line.querySelector("button")?.setAttribute("aria-pressed", String(shown));
    const [, state, mode, link, error] = line.cells;
    put(state.children[0], glyph);
    put(state.children[1], word + remarks(seen));
    put(mode, seen.mode || UNKNOWN);
    put(link, linkWords(seen));
    line.title = seen.vehicle;
    put(error, seen.error_m == null ? UNKNOWN : `${figure(seen.error_m, seen.error_m < 100 ? 2 : 0)} m`);
  }
}

/** What is odd about it, in words. @param {any} seen */
export function remarks(seen) {
  const odd = [];
  if (seen.contact === "live" && quietLink(seen)) odd.push(`link quiet ${duration(seen.heartbeat_age_s)}`);
  if (seen.doubled) odd.push("two services!");
  if (seen.versions.length) odd.push(`schema ${seen.versions.join(", ")}`);
  return odd.length ? `, ${odd.join(", ")}` : "";
}

/** How long the way to the autopilot and back takes, or that it is quiet. @param {any} seen */
function linkWords(seen) {
  if (seen.contact !== "live") return UNKNOWN;
  if (quietLink(seen)) return "quiet";
  return seen.round_trip_s == null ? UNKNOWN : `${figure(seen.round_trip_s * 1e3, 1)} ms`;
}

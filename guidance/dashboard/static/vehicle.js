/** The vehicle that is shown: its state and why, what blocks engaging, readings, link and loop in words. */

import { remarks } from "./fleet.js";
import { duration, figure, look, make, put, STATES, UNKNOWN } from "./words.js";

const BLOCKED = "Blocks engaging";
const AGAIN = /** @type {[string, string]} */ (["To engage again", "Order it: conditions are looked at then, and the answer names one that is not met."]);
/**
 * States in which nothing is flown: a title, and what it says of engaging; empty is the reason that the vehicle gives.
 * @type {Map<string, [string, string]>}
 */
const BLOCKS = new Map([
  ["disconnected", [BLOCKED, ""]],
  ["connected", [BLOCKED, ""]],
  ["withheld", [BLOCKED, ""]],
  ["ready", [BLOCKED, "Nothing: it may be engaged."]],
  ["handed-over", AGAIN],
  ["aborted", AGAIN],
  ["finished", ["To engage again", "Start its service: this one has ended."]],
]);

const $ = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));

/**
 * What stands beside the scene: name, unit, the figure, and the column of what is told of a vehicle that is lost.
 * @type {[string, string, (rows: import("./rows.js").Rows, seen: any) => string, string?][]}
 */
const READINGS = [
  ["Error", "m", (rows) => figure(rows.newest("error"), 3)],
  ["Speed", "m/s", (rows) => figure(rows.newest("speed"), 2)],
  ["Up", "m", (rows) => figure(-rows.newest("down"), 2), "down"],
  ["North", "m", (rows) => figure(rows.newest("north"), 2), "north"],
  ["East", "m", (rows) => figure(rows.newest("east"), 2), "east"],
  ["Setpoints", "Hz", (_, seen) => figure(seen?.setpoint_rate_hz, 1)],
  ["Round trip", "ms", (_, seen) => figure(seen?.round_trip_s == null ? null : seen.round_trip_s * 1e3, 1)],
  ["Lost", "packets", (_, seen) => (seen?.lost == null ? UNKNOWN : String(seen.lost))],
];

export class VehiclePanel {
  constructor() {
    /** @type {HTMLElement[]} */
    this.terms = [];
    this.values = READINGS.map(([name, unit]) => {
      const value = make("b", "value");
      const pair = make("div");
      const term = make("dt", "", name);
      const figures = make("dd");
      figures.append(value, make("span", "unit", unit));
      pair.append(term, figures);
      $("readings").append(pair);
      this.terms.push(term);
      return value;
    });
  }

  /** What is known at a glance. @param {any} seen */
  show(seen) {
    const { tone, glyph, word } = look(seen);
    const live = seen.contact === "live";
    const panel = $("vehicle");
    panel.hidden = false;
    panel.dataset.tone = tone;
    panel.dataset.contact = seen.contact;
    put($("name"), seen.vehicle);
    put($("state").children[0], glyph);
    put($("state-word"), word + remarks(seen));
    const sentence = STATES[seen.state ?? ""]?.[2] ?? "";
    const [title, said] = BLOCKS.get(seen.state ?? "") ?? ["", ""];
    const below = Boolean(title) && !said; // the reason is what blocks
    const reason = seen.reason && !below ? `${sentence ? `${sentence}: ` : ""}${seen.reason}` : sentence;
    put($("reason"), live ? reason || "It publishes nothing that this version reads." : `Last said: ${seen.state ?? "nothing"}${seen.reason ? `, ${seen.reason}` : ""}`);
    const blocks = $("blocks");
    blocks.hidden = !live || !BLOCKS.has(seen.state ?? "");
    put(blocks.children[0], title);
    put(blocks.children[1], said || seen.reason || "It does not say.");
    const veil = $("veil");
    veil.hidden = live;
    if (!live) put(veil, `${seen.contact} for ${duration(seen.quiet_s)}: what is drawn is old`);
  }

  /** What is known in full. @param {any} about */
  detail(about) {
    const { session, status, link, timing } = about;
    put($("identity"), session ? `${session.profile}, guidance ${session.version}` : "");
    const parts = [];
    if (status?.fresh) {
      parts.push(`for ${duration(status.for_s)}`);
      if (status.armed !== null) parts.push(status.armed ? "armed" : "disarmed");
      if (status.mode) parts.push(`mode ${status.mode}`);
      if (status.intended_mode && status.intended_mode !== status.mode) parts.push(`wanted ${status.intended_mode}`);
    }
    put($("state-for"), parts.join(", "));
    const cautions = status?.fresh ? status.cautions : [];
    const list = $("cautions");
    list.hidden = !cautions.length;
    if (list.dataset.said !== cautions.join("\n")) {
      list.dataset.said = cautions.join("\n");
      list.replaceChildren(...cautions.map((/** @type {string} */ text) => make("li", "", text)));
    }
    put($("link-words"), words(link, timing, about.fence));
    const streams = (link?.streams ?? []).map(streamLine);
    const key = streams.map((/** @type {HTMLElement} */ line) => line.textContent).join();
    if ($("streams").dataset.said !== key) {
      $("streams").dataset.said = key;
      $("streams").replaceChildren(...streams);
    }
  }

  /** The figures beside the scene. @param {import("./rows.js").Rows} rows @param {any} seen */
  readings(rows, seen) {
    const live = seen?.contact === "live" && rows.fresh();
    READINGS.forEach(([name, , read, column], k) => {
      const i = column && (!live || Number.isNaN(rows.newest(column))) ? rows.known(column) : -1;
      const last = column && i >= 0 ? rows.get(i, column) : NaN;
      put(this.terms[k], i >= 0 ? `Last ${name.toLowerCase()}` : name);
      this.values[k].classList.toggle("old", i >= 0);
      if (i >= 0) put(this.values[k], figure(column === "down" ? -last : last, 2));
      else put(this.values[k], live ? read(rows, seen) : UNKNOWN);
    });
  }
}

/** One message stream: only of one that the service insists on does the rate matter. @param {any} stream */
function streamLine(stream) {
  const poor = stream.insisted && !stream.good;
  const none = !poor && !(stream.comes && stream.rate_hz >= 0.05);
  const wanted = stream.insisted ? ` of ${figure(stream.wanted_hz, 0)}` : "";
  const line = make("li", poor ? "poor" : "", `${poor ? "!" : none ? "○" : "✓"} ${stream.message} `);
  line.append(make("span", "value", none ? "not needed" : `${figure(stream.rate_hz, 1)}${wanted} Hz`));
  return line;
}

/** @param {any} link @param {any} timing @param {any} fence */
function words(link, timing, fence) {
  const said = [];
  if (link) said.push(`${link.transport || "link"}: ${link.received} packets received, ${link.lost} lost`);
  if (timing) {
    said.push(`loop at most ${figure(timing.lateness_max_s * 1e3, 1)} ms late in this run, largest gap between setpoints ${figure(timing.setpoint_gap_max_s * 1e3, 0)} ms`);
    if (timing.dropped_records) said.push(`${timing.dropped_records} records of telemetry dropped`);
  }
  if (fence?.degrees) said.push("the fence is not drawn: it is in degrees, and the autopilot has not said where its local origin is");
  return said.length ? `${said.join("; ")}.` : "No figures of link and loop.";
}

/** Figures and states as an operator reads them. */

/** What is not known. */
export const UNKNOWN = "–";

/**
 * A figure with a fixed number of decimals; large and tiny ones in powers of ten.
 * @param {number|null|undefined} value
 * @param {number} decimals
 */
export function figure(value, decimals) {
  if (value == null || !Number.isFinite(value)) return UNKNOWN;
  if (Math.abs(value) >= 1e5) return value.toExponential(1);
  return value.toFixed(decimals).replace(/^-(0\.?0*)$/, "$1").replace("-", "−");
}

/** A duration in the unit that suits it. @param {number|null|undefined} seconds */
export function duration(seconds) {
  if (seconds == null || !Number.isFinite(seconds)) return UNKNOWN;
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.floor(seconds)} s`;
  if (seconds < 7200) return `${Math.floor(seconds / 60)} min`;
  return `${Math.floor(seconds / 3600)} h`;
}

/** Time of day, local. @param {number} unixS */
export function clock(unixS) {
  return unixS > 0 ? new Date(unixS * 1000).toLocaleTimeString([], { hour12: false }) : UNKNOWN;
}

/**
 * The supervisor's states: a tone (a colour), a glyph (so that colour is not the only sign), and words.
 * @type {Record<string, [string, string, string]>}
 */
export const STATES = {
  disconnected: ["bad", "✕", "no autopilot is heard"],
  connected: ["idle", "○", "the autopilot is heard"],
  withheld: ["warn", "!", "not ready"],
  ready: ["busy", "○", "may be engaged"],
  streaming: ["busy", "◐", "engaging: setpoints flow"],
  switching: ["busy", "◐", "engaging: the mode is asked for"],
  arming: ["busy", "◐", "engaging: arming"],
  tracking: ["good", "●", "in control"],
  pausing: ["warn", "◐", "stopping"],
  holding: ["warn", "‖", "held"],
  aborting: ["bad", "◐", "aborting"],
  cancelling: ["warn", "◐", "engaging is cancelled"],
  "backing-out": ["warn", "◐", "control is given back"],
  leaving: ["warn", "◐", "control is given back"],
  "handed-over": ["idle", "○", "the pilot has control"],
  aborted: ["bad", "✕", "the flight was aborted"],
  finished: ["idle", "■", "the flight is over"],
};

/**
 * How a vehicle looks: its state while it is heard, else how it is heard.
 * @param {{contact: string, state: string|null, quiet_s: number, doubled: boolean, heartbeat_age_s?: number|null}} seen
 * @returns {{tone: string, glyph: string, word: string}}
 */
export function look(seen) {
  if (seen.contact !== "live") {
    const quiet = duration(seen.quiet_s).replace(" ", "\u00a0");
    return { tone: seen.contact === "silent" ? "bad" : "idle", glyph: "✕", word: `${seen.contact}\u00a0${quiet}` };
  }
  const state = seen.state ?? "";
  const [tone, glyph] = Object.hasOwn(STATES, state) ? STATES[state] : ["idle", "?"];
  const [worst, sign] = seen.doubled || quietLink(seen) ? ["bad", "!"] : [tone, glyph];
  return { tone: worst, glyph: sign, word: seen.state ?? "unknown" };
}

/** Whether the service hears its autopilot no more. @param {{heartbeat_age_s?: number|null}} seen */
export const quietLink = ({ heartbeat_age_s }) => heartbeat_age_s != null && heartbeat_age_s > 2;

/** Set a text only when it changed. @param {Element} element @param {string} text */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * An element with a class and a text.
 * @param {string} tag @param {string} [className] @param {string} [text]
 */
export function make(tag, className = "", text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  return element;
}

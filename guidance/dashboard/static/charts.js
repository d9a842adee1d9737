/** Which charts there are: what is commanded depends on the vehicle. */

import { Chart } from "./chart.js";

/** @typedef {import("./chart.js").Spec} Spec */

const DEG = 180 / Math.PI;

/**
 * What was asked for, dashed, and what was measured.
 * @param {string} id @param {string} title @param {string} set @param {string} measured @param {Partial<Spec>} more
 * @returns {Spec}
 */
const against = (id, title, set, measured, more) => ({
  id,
  title,
  series: [
    { column: set, label: "set", colour: "b", dash: [5, 3] },
    { column: measured, label: "measured", colour: "a" },
  ],
  ...more,
});

/** @type {Spec[]} */
const BEFORE = [
  {
    id: "error",
    title: "Error, m",
    decimals: 3,
    span: 0.05,
    series: [
      { column: "error_peak", words: "error", label: "|e|", colour: "a" },
      { column: "error_north", label: "N", colour: "b", dash: [6, 3] },
      { column: "error_east", label: "E", colour: "c", dash: [2, 2] },
      { column: "error_down", label: "D", colour: "d", dash: [8, 3, 2, 3] },
    ],
  },
  {
    id: "distance",
    title: "Error |e|, m, by powers of ten",
    log: true,
    series: [{ column: "error_peak", words: "error", label: "|e|", colour: "a" }],
  },
  {
    id: "lyapunov",
    title: "V1, V2",
    log: true,
    series: [
      { column: "v1", label: "V1", colour: "a" },
      { column: "v2", label: "V2", colour: "b", dash: [5, 3] },
    ],
  },
];
const speed = against("speed", "Speed, m/s", "speed_set", "speed", { span: 0.5 });
const yaw = against("yaw-rate", "Yaw rate, rad/s", "yaw_rate_set", "yaw_rate", { span: 0.2, decimals: 3 });
const rollRate = against("roll-rate", "Roll rate, rad/s", "roll_rate_set", "roll_rate", { span: 0.2, decimals: 3, optional: true });
const pitchRate = against("pitch-rate", "Pitch rate, rad/s", "pitch_rate_set", "pitch_rate", { span: 0.2, decimals: 3, optional: true });
const airspeed = against("airspeed", "Airspeed, m/s", "airspeed_set", "airspeed", { span: 2, decimals: 1, optional: true });
const level = [
  against("v-north", "Velocity north, m/s", "v_north_set", "v_north", { span: 0.5 }),
  against("v-east", "Velocity east, m/s", "v_east_set", "v_east", { span: 0.5 }),
];
const thrust = /** @type {Spec} */ ({ id: "thrust", title: "Thrust, 0 to 1", span: 0.2, zero: true, series: [{ column: "thrust", label: "set", colour: "a" }] });

/** By what a vehicle is told: `asked` of `about`. @type {Record<string, Spec[]>} */
const COMMANDED = {
  rates_speed: [yaw, speed, pitchRate, rollRate, thrust],
  rates_throttle: [yaw, pitchRate, rollRate, thrust, airspeed],
  attitude_throttle: [
    against("bank", "Bank, °", "bank_set", "bank", { span: 10, decimals: 1, times: DEG }),
    against("pitch", "Pitch, °", "pitch_set", "pitch", { span: 5, decimals: 1, times: DEG }),
    airspeed,
    thrust,
  ],
  velocity: [...level, against("v-down", "Velocity down, m/s", "v_down_set", "v_down", { span: 0.5 }), yaw],
  level_velocity: level,
};
const COMMON = "rates_speed";

/** @type {Spec[]} */
const AFTER = [
  { id: "lateness", title: "Loop lateness, ms, at most", times: 1e3, decimals: 1, span: 1, zero: true, series: [{ column: "lateness", label: "last second", colour: "a" }] },
  {
    id: "ages",
    title: "Age of data, ms",
    times: 1e3,
    decimals: 0,
    span: 50,
    zero: true,
    series: [
      { column: "attitude_age", label: "attitude", colour: "a" },
      { column: "position_age", label: "position", colour: "b", dash: [5, 3] },
      { column: "uplink_age", label: "uplink", colour: "c", dash: [2, 2] },
    ],
  },
];

export class Charts {
  /** @param {HTMLElement} place */
  constructor(place) {
    this.place = place;
    this.kind = "";
    /** @type {Chart[]} */
    this.charts = [];
    this.show("");
  }

  /** The charts of a vehicle that is told so. @param {string} asked */
  show(asked) {
    const kind = Object.hasOwn(COMMANDED, asked) ? asked : COMMON;
    if (kind === this.kind) return;
    this.kind = kind;
    this.charts = [...BEFORE, ...COMMANDED[kind], ...AFTER].map((spec) => new Chart(spec));
    this.place.replaceChildren(...this.charts.map((chart) => chart.figure));
  }

  /** @param {import("./rows.js").Rows} rows @param {number} windowS */
  draw(rows, windowS) {
    for (const chart of this.charts) chart.draw(rows, windowS);
  }
}

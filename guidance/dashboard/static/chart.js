/** One chart over time, with the newest figures as words above it. */

import { linear, logarithmic } from "./axis.js";
import { fitted } from "./canvas.js";
import { colours } from "./theme.js";
import { figure, make, put } from "./words.js";

/** @typedef {import("./rows.js").Rows} Rows */
/**
 * @typedef {object} Series
 * @property {string} column
 * @property {string} label
 * @property {"a"|"b"|"c"|"d"} colour
 * @property {number[]} [dash] so that colour is not the only difference
 * @property {string} [words] another column for the figure in words
 */
/**
 * @typedef {object} Spec
 * @property {string} id
 * @property {string} title with its unit
 * @property {Series[]} series
 * @property {number} [span] at least so much is shown
 * @property {number} [times] figures are shown so many times as large: 1e3 for ms
 * @property {number} [decimals]
 * @property {boolean} [log]
 * @property {boolean} [zero] zero is always shown
 * @property {boolean} [optional] hidden while there is nothing but zero in it
 */

const LEFT = 46;
const RIGHT = 8;
const TOP = 8;
const BOTTOM = 18;

export class Chart {
  /** @param {Spec} spec */
  constructor(spec) {
    this.spec = spec;
    this.times = spec.times ?? 1;
    this.figure = make("figure");
    this.figure.id = `chart-${spec.id}`;
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${spec.title}, over time`);
    const caption = make("figcaption");
    caption.append(make("b", "", spec.title));
    this.figures = spec.series.map((series) => {
      const label = make("span", `key drawn series-${series.colour}`);
      const line = make("span", "line");
      line.style.backgroundImage = pattern(series.dash);
      const value = make("b", "value");
      label.append(line, series.label, value);
      caption.append(label);
      return value;
    });
    this.figure.append(caption, this.canvas);
  }

  /** @param {Rows} rows @param {number} windowS */
  draw(rows, windowS) {
    const { spec } = this;
    const nowS = rows.nowS();
    const first = rows.since(nowS - windowS);
    const columns = spec.series.map((series) => rows.at[series.column]);
    if (columns.includes(undefined)) return;
    const [low, high] = this.#range(rows, first, columns);
    this.figure.hidden = Boolean(spec.optional) && !(high > 1e-6 || low < -1e-6);
    if (this.figure.hidden) return;
    const fresh = rows.fresh();
    spec.series.forEach((series, k) => {
      const newest = fresh ? rows.newest(series.words ?? series.column) * this.times : NaN;
      put(this.figures[k], spec.log && newest > 0 ? newest.toExponential(1).replace("-", "−") : figure(newest, spec.decimals ?? 2));
    });

    const { c, width, height } = fitted(this.canvas);
    if (width < LEFT + RIGHT) return;
    const inner = width - LEFT - RIGHT;
    const across = (/** @type {number} */ s) => LEFT + inner * (1 - (nowS - s) / windowS);
    this.#instants(c, width, height, windowS);
    if (!(high >= low)) {
      c.textAlign = "center";
      c.fillText("nothing in this time", LEFT + inner / 2, (height - BOTTOM) / 2 + 4);
      return;
    }
    const axis = spec.log ? logarithmic(low, high) : linear(low, high, spec.span ?? 0.1);
    const up = (/** @type {number} */ v) => height - BOTTOM - (height - BOTTOM - TOP) * axis.place(v);
    c.textAlign = "right";
    for (const tick of axis.ticks) {
      const y = Math.round(up(tick)) + 0.5;
      c.globalAlpha = tick === 0 ? 1 : 0.55;
      c.beginPath();
      c.moveTo(LEFT, y);
      c.lineTo(width - RIGHT, y);
      c.stroke();
      c.globalAlpha = 1;
      c.fillText(axis.label(tick), LEFT - 6, y + 3.5);
    }
    c.save();
    c.beginPath();
    c.rect(LEFT, 0, inner + 2, height - BOTTOM + 1);
    c.clip();
    c.lineJoin = "round";
    // The measured ones lie under what they are held against.
    for (let k = columns.length - 1; k >= 0; k--) {
      c.strokeStyle = colours[spec.series[k].colour];
      c.lineWidth = 2;
      c.setLineDash(spec.series[k].dash ?? []);
      trace(c, rows, first, columns[k], across, (v) => up(v * this.times));
    }
    c.restore();
  }

  /** @param {Rows} rows @param {number} first @param {number[]} columns */
  #range(rows, first, columns) {
    let low = this.spec.zero ? 0 : Infinity;
    let high = -Infinity;
    const least = this.spec.log ? Number.MIN_VALUE : -Infinity;
    for (let i = first; i < rows.held; i++) {
      const at = rows.slot(i) * rows.width;
      for (const column of columns) {
        const value = rows.data[at + column];
        if (value < low && value >= least) low = value;
        if (value > high) high = value;
      }
    }
    return [low * this.times, high * this.times];
  }

  /** @param {CanvasRenderingContext2D} c @param {number} width @param {number} height @param {number} windowS */
  #instants(c, width, height, windowS) {
    c.font = "11px system-ui, sans-serif";
    c.fillStyle = colours.soft;
    c.strokeStyle = colours.line;
    c.lineWidth = 1;
    const inner = width - LEFT - RIGHT;
    for (let k = 0; k <= 3; k++) {
      const x = LEFT + (inner * k) / 3;
      const s = (windowS * (3 - k)) / 3;
      c.textAlign = k === 3 ? "right" : "center";
      c.fillText(s ? `−${s} s` : "now", x, height - 4);
    }
  }
}

/** A line of a key, dashed as it is drawn. @param {number[]} [dash] */
function pattern(dash = [1, 0]) {
  let at = 0;
  const stops = dash.map((length, k) => {
    const from = at;
    at += length;
    return `${k % 2 ? "transparent" : "currentColor"} ${from}px ${at}px`;
  });
  return `repeating-linear-gradient(90deg, ${stops.join(", ")})`;
}

/**
 * A line through a column; it ends where nothing is known. Where rows are closer than pixels each pixel shows
 * the least and the most.
 * @param {CanvasRenderingContext2D} c @param {Rows} rows @param {number} first @param {number} column
 * @param {(s: number) => number} across @param {(v: number) => number} up
 */
function trace(c, rows, first, column, across, up) {
  let pen = false;
  let pixel = -1;
  let least = 0;
  let most = 0;
  let last = 0;
  const flush = () => {
    if (least !== most) {
      c.lineTo(pixel, least);
      c.lineTo(pixel, most);
    }
    c.lineTo(pixel, last);
  };
  c.beginPath();
  for (let i = first; i < rows.held; i++) {
    const slot = rows.slot(i);
    const value = rows.data[slot * rows.width + column];
    if (Number.isNaN(value)) {
      if (pen) flush();
      pen = false;
      continue;
    }
    const x = Math.round(across(rows.times[slot]) * 2) / 2;
    const y = up(value);
    if (pen && x === pixel) {
      if (y < least) least = y;
      if (y > most) most = y;
    } else {
      if (pen) flush();
      else c.moveTo(x, y);
      pen = true;
      pixel = x;
      least = most = y;
    }
    last = y;
  }
  if (pen) flush();
  c.stroke();
}

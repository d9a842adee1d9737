/** Reference path, flown path, pose, desired field and fence, in local NED with up upwards. */

import { roundStep } from "./axis.js";
import { Camera } from "./camera.js";
import { fitted } from "./canvas.js";
import { colours } from "./theme.js";
import { duration, figure } from "./words.js";

/** @typedef {import("./rows.js").Rows} Rows */
/** @typedef {[number, number, number]} Triple */
/** @typedef {{points: number[], whole: boolean}} Plan north, east and down in turn, m from the trajectory's origin */
/** @typedef {{corners: [number, number][], down_min_m: number|null, down_max_m: number|null, degrees: boolean}} Fence */

const POINTS_MAX = 1500;
const FIELD_PX = 64;
const BODY_PX = 26;
/** A fence is fitted into the view if it is no wider than so many times the paths. */
const FENCE_TIMES = 4;
/** The outline of the vehicle in body axes (x ahead, y right, z down): from above, and its fin. */
const HULL = /** @type {Triple[]} */ ([[1, 0, 0], [-0.8, 0.62, 0], [-0.45, 0, 0], [-0.8, -0.62, 0]]);
const FIN = /** @type {Triple[]} */ ([[-0.1, 0, 0], [-0.75, 0, -0.5], [-0.62, 0, 0]]);

/** A body vector in local NED. @param {Float32Array} q wxyz @param {Triple} v @returns {Triple} */
export function turned([w, x, y, z], [a, b, c]) {
  return [
    (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
    2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
    2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
  ];
}

export class Scene {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.camera = new Camera();
    /** @type {Fence|null} */
    this.fence = null;
    /** @type {Plan|null} */
    this.plan = null;
    /** @type {Triple|null} where the trajectory's origin is */
    this.origin = null;
    this.reset();
  }

  /** Another vehicle is shown: it is fitted anew. */
  reset() {
    this.bounds = null;
    this.fence = this.plan = this.origin = null;
    this.camera.whole();
  }

  /** @param {Rows} rows @param {number} windowS paths are drawn over so long */
  draw(rows, windowS) {
    const { c, width, height } = fitted(this.canvas);
    const last = this.#lastPose(rows);
    // The way of a vehicle that is lost stays: it is what a search needs.
    this.first = rows.since((last?.old ? last.atS : rows.nowS()) - windowS);
    const found = bounds(rows, this.first) ?? bounds(rows, 0);
    if (!found || width < 2) return;
    if (this.plan?.whole && this.origin) widen(found, this.plan.points, this.origin);
    if (this.fence) include(found, this.fence);
    this.#fit(found);
    const { camera } = this;
    if (camera.follow && last) camera.aim(last.place[0], last.place[1], last.place[2]);
    camera.lens(width, height);
    c.lineJoin = c.lineCap = "round";
    const ground = this.#ground(c, found);
    if (this.fence) this.#fence(c, this.fence, ground);
    this.#path(c, rows, "north", { colour: colours.soft, width: 1, alpha: 0.7, dash: [], down: ground });
    if (this.plan && this.origin) this.#plan(c, this.plan.points, this.origin);
    this.#path(c, rows, "ref_north", { colour: colours.b, width: 4, alpha: 0.6, dash: [] });
    this.#path(c, rows, "north", { colour: colours.a, width: 2, alpha: 1, dash: [] });
    if (last) this.#vehicle(c, last, ground);
    this.#compass(c, height);
  }

  /** The middle and the extent stay until what is drawn outgrows them, or is small in them. @param {Box} found */
  #fit(found) {
    const held = this.bounds;
    const size = Math.max(2, ...found.map(([low, high]) => high - low));
    const outside = held && found.some(([low, high], k) => low < held[k][0] - 1e-9 || high > held[k][1] + 1e-9);
    if (!held || outside || size < 0.3 * this.extent || this.camera.unframed) {
      const pad = 0.06 * size;
      this.bounds = /** @type {Box} */ (found.map(([low, high]) => [low - pad, high + pad]));
      this.extent = size;
      this.camera.frame(this.bounds.map(([low, high]) => Math.max(high - low, 0.1 * size)));
    }
    if (this.bounds && !this.camera.follow) {
      const [n, e, d] = this.bounds.map(([low, high]) => (low + high) / 2);
      this.camera.aim(n, e, d);
    }
  }

  /** The newest pose that is known, however old. @param {Rows} rows */
  #lastPose(rows) {
    const i = rows.known("north");
    if (i < 0) return null;
    const at = rows.slot(i) * rows.width;
    const column = (/** @type {string} */ name, count = 1) => rows.data.subarray(at + rows.at[name], at + rows.at[name] + count);
    return {
      place: column("north", 3),
      q: column("qw", 4),
      field: column("field_x", 3),
      reference: column("ref_north", 3),
      old: i < rows.held - 1 || !rows.fresh(),
      atS: rows.times[rows.slot(i)],
      ageS: rows.nowS() - rows.times[rows.slot(i)],
    };
  }

  /** A grid below everything; its down coordinate is returned. @param {CanvasRenderingContext2D} c @param {Box} found */
  #ground(c, found) {
    const { camera } = this;
    const bottom = found[2][1];
    const shown = (Math.hypot(camera.width, camera.height) / camera.perMetre) * 0.62;
    const step = roundStep(shown / 9);
    const down = bottom;
    const count = Math.min(40, Math.ceil(shown / step / Math.max(0.35, camera.cosTilt)));
    const n0 = Math.round(camera.north / step);
    const e0 = Math.round(camera.east / step);
    c.lineWidth = 1;
    c.strokeStyle = colours.line;
    c.setLineDash([]);
    c.globalAlpha = 0.75;
    c.beginPath();
    const reach = count * step;
    for (let k = -count; k <= count; k++) {
      c.moveTo(...camera.place((n0 + k) * step, e0 * step - reach, down));
      c.lineTo(...camera.place((n0 + k) * step, e0 * step + reach, down));
      c.moveTo(...camera.place(n0 * step - reach, (e0 + k) * step, down));
      c.lineTo(...camera.place(n0 * step + reach, (e0 + k) * step, down));
    }
    c.stroke();
    c.globalAlpha = 1;
    c.fillStyle = colours.soft;
    c.font = "12px system-ui, sans-serif";
    c.textAlign = "right";
    c.fillText(`grid ${Number(step.toPrecision(1))} m, at ${figure(-down, 1)} m up`, camera.width - 10, camera.height - 10);
    return down;
  }

  /** @param {CanvasRenderingContext2D} c @param {Fence} fence @param {number} ground */
  #fence(c, fence, ground) {
    const { camera } = this;
    const { corners } = fence;
    if (!corners.length) return;
    const levels = [fence.down_min_m, fence.down_max_m].filter((level) => level !== null);
    if (levels.length < 2) levels.push(ground);
    c.strokeStyle = colours.bad;
    c.lineWidth = 1.5;
    c.setLineDash([10, 4, 2, 4]);
    c.globalAlpha = 0.8;
    for (const level of levels) {
      c.beginPath();
      corners.forEach(([n, e], k) => (k ? c.lineTo(...camera.place(n, e, level)) : c.moveTo(...camera.place(n, e, level))));
      c.closePath();
      c.stroke();
    }
    if (levels.length === 2) {
      c.beginPath();
      for (const [n, e] of corners) {
        c.moveTo(...camera.place(n, e, levels[0]));
        c.lineTo(...camera.place(n, e, levels[1]));
      }
      c.stroke();
    }
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  /** What is planned. @param {CanvasRenderingContext2D} c @param {number[]} points @param {Triple} origin */
  #plan(c, points, [north, east, down]) {
    c.strokeStyle = colours.b;
    c.lineWidth = 1.25;
    c.beginPath();
    for (let k = 0; k + 2 < points.length; k += 3) {
      c.lineTo(...this.camera.place(north + points[k], east + points[k + 1], down + points[k + 2]));
    }
    c.stroke();
  }

  /**
   * The path in three columns; `down` lays it flat there.
   * @param {CanvasRenderingContext2D} c @param {Rows} rows @param {string} column
   * @param {{colour: string, width: number, alpha: number, dash: number[], down?: number}} style
   */
  #path(c, rows, column, style) {
    const first = rows.at[column];
    const count = rows.held - this.first;
    if (count < 2) return;
    const each = Math.ceil(count / POINTS_MAX);
    // The same rows are drawn each time, so that the path does not shimmer as it grows.
    const from = this.first + ((each - (Math.round(rows.times[rows.slot(this.first)] * 20) % each)) % each);
    c.strokeStyle = style.colour;
    c.lineWidth = style.width;
    c.globalAlpha = style.alpha;
    c.setLineDash(style.dash);
    c.beginPath();
    let pen = false;
    for (let i = from; i < rows.held; i = i + each < rows.held || i === rows.held - 1 ? i + each : rows.held - 1) {
      const at = rows.slot(i) * rows.width + first;
      const north = rows.data[at];
      if (Number.isNaN(north)) {
        pen = false;
        continue;
      }
      const place = this.camera.place(north, rows.data[at + 1], style.down ?? rows.data[at + 2]);
      if (pen) c.lineTo(...place);
      else c.moveTo(...place);
      pen = true;
    }
    c.stroke();
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  /**
   * An old pose is an outline with its age, and nothing that it was to do.
   * @param {CanvasRenderingContext2D} c
   * @param {{place: Float32Array, q: Float32Array, field: Float32Array, reference: Float32Array, old: boolean, ageS: number}} pose
   * @param {number} ground
   */
  #vehicle(c, { place, q, field, reference, old, ageS }, ground) {
    const { camera } = this;
    const [n, e, d] = place;
    const [x, y] = camera.place(n, e, d);
    const at = (/** @type {Triple} */ body, /** @type {number} */ px) => {
      const [u, v] = camera.direction(...turned(q, body));
      return /** @type {[number, number]} */ ([x + px * u, y + px * v]);
    };
    const outline = (/** @type {Triple[]} */ shape, /** @type {string} */ fill) => {
      c.beginPath();
      shape.forEach((corner, k) => (k ? c.lineTo(...at(corner, BODY_PX)) : c.moveTo(...at(corner, BODY_PX))));
      c.closePath();
      c.fillStyle = fill;
      if (!old) c.fill();
      c.strokeStyle = old ? colours.soft : colours.panel;
      c.lineWidth = 1.5;
      c.stroke();
    };
    c.strokeStyle = colours.soft;
    c.lineWidth = 1;
    c.setLineDash([2, 3]);
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(...camera.place(n, e, ground));
    c.stroke();
    c.setLineDash([]);
    if (old) {
      c.fillStyle = colours.ink;
      c.font = "600 12px system-ui, sans-serif";
      c.textAlign = "center";
      c.fillText(`position ${duration(ageS)} old`, x, y + BODY_PX + 16);
    }
    if (!old && !Number.isNaN(reference[0])) {
      const [rx, ry] = camera.place(reference[0], reference[1], reference[2]);
      c.strokeStyle = colours.b;
      c.lineWidth = 1.5;
      c.beginPath();
      c.moveTo(x, y);
      c.lineTo(rx, ry);
      c.stroke();
      c.lineWidth = 2.5;
      c.beginPath();
      c.arc(rx, ry, 5, 0, 2 * Math.PI);
      c.stroke();
    }
    const size = Math.hypot(...field);
    if (!old && size > 1e-9) {
      const tip = at([field[0] / size, field[1] / size, field[2] / size], FIELD_PX);
      arrow(c, [x, y], tip, colours.d);
    }
    if (Number.isNaN(q[0])) return;
    outline(HULL, colours.ink);
    outline(FIN, colours.a);
  }

  /** North, east and up. @param {CanvasRenderingContext2D} c @param {number} height */
  #compass(c, height) {
    const x = 42;
    const y = height - 46;
    c.font = "600 12px system-ui, sans-serif";
    c.textAlign = "center";
    for (const [name, direction] of /** @type {[string, Triple][]} */ ([["N", [1, 0, 0]], ["E", [0, 1, 0]], ["up", [0, 0, -1]]])) {
      const [u, v] = this.camera.direction(...direction);
      if (Math.hypot(u, v) < 0.2) continue;
      c.strokeStyle = c.fillStyle = colours.soft;
      c.lineWidth = 1.5;
      c.beginPath();
      c.moveTo(x, y);
      c.lineTo(x + 24 * u, y + 24 * v);
      c.stroke();
      c.fillText(name, x + 34 * u, y + 34 * v + 4);
    }
  }
}

/** @typedef {[number, number][]} Box low and high of north, east and down, m */

/** What the paths take up; null while there is nothing. @param {Rows} rows @param {number} first @returns {Box|null} */
function bounds(rows, first) {
  const box = /** @type {Box} */ ([0, 1, 2].map(() => [Infinity, -Infinity]));
  const each = Math.max(1, Math.floor(rows.held / POINTS_MAX));
  for (let i = rows.held - 1; i >= first; i -= each) {
    const at = rows.slot(i) * rows.width;
    for (const column of [rows.at.north, rows.at.ref_north]) {
      for (let k = 0; k < 3; k++) {
        const value = rows.data[at + column + k];
        if (value < box[k][0]) box[k][0] = value;
        if (value > box[k][1]) box[k][1] = value;
      }
    }
  }
  return box.every(([low, high]) => high >= low) ? box : null;
}

/** Make room for a plan. @param {Box} box @param {number[]} points @param {Triple} origin */
function widen(box, points, origin) {
  points.forEach((metres, i) => {
    const span = box[i % 3];
    span[0] = Math.min(span[0], origin[i % 3] + metres);
    span[1] = Math.max(span[1], origin[i % 3] + metres);
  });
}

/** Make room for a fence that is not much wider than the rest. @param {Box} box @param {Fence} fence */
function include(box, { corners }) {
  const wide = Math.max(2, box[0][1] - box[0][0], box[1][1] - box[1][0]);
  const room = [0, 1].map((k) => {
    const along = corners.map((corner) => corner[k]);
    return [Math.min(box[k][0], ...along), Math.max(box[k][1], ...along)];
  });
  if (room.some(([low, high]) => high - low > FENCE_TIMES * wide)) return;
  room.forEach(([low, high], k) => { box[k] = [low, high]; });
}

/** @param {CanvasRenderingContext2D} c @param {[number, number]} from @param {[number, number]} to @param {string} colour */
function arrow(c, from, to, colour) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(dx, dy);
  c.strokeStyle = c.fillStyle = colour;
  c.lineWidth = 2.5;
  c.beginPath();
  c.moveTo(...from);
  c.lineTo(...to);
  c.stroke();
  if (length < 8) return;
  const [u, v] = [dx / length, dy / length];
  c.beginPath();
  c.moveTo(to[0] + 4 * u, to[1] + 4 * v);
  c.lineTo(to[0] - 8 * u + 5 * v, to[1] - 8 * v - 5 * u);
  c.lineTo(to[0] - 8 * u - 5 * v, to[1] - 8 * v + 5 * u);
  c.fill();
}

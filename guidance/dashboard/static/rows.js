/** The rows of one vehicle, as the server keeps them: a ring of float32 beside the instants. */

export class Rows {
  constructor() {
    /** @type {Record<string, number>} */
    this.at = {};
    this.begin([], 4096, 1);
  }

  /**
   * All of another vehicle come next.
   * @param {string[]} columns @param {number} wrapS @param {number} capacity
   * @param {number} kept so many of them are of before, @param {number} ageS the newest so old
   */
  begin(columns, wrapS, capacity, kept = 0, ageS = 0) {
    this.kept = kept;
    this.keptMs = performance.now() - 1000 * ageS;
    this.width = columns.length;
    this.at = Object.fromEntries(columns.map((name, i) => [name, i]));
    this.wrapS = wrapS;
    this.capacity = capacity;
    this.data = new Float32Array(capacity * this.width);
    this.times = new Float64Array(capacity);
    this.head = 0;
    this.held = 0;
    this.lastS = 0;
    this.heardMs = -Infinity;
  }

  /** @param {Float32Array} rows */
  take(rows) {
    if (!this.width) return;
    for (let i = 0; i + this.width <= rows.length; i += this.width) {
      const wrapped = rows[i];
      // The server counts modulo wrapS; instants of this page go on.
      const turns = Math.ceil((this.lastS - wrapped) / this.wrapS - 1e-6);
      this.lastS = this.held ? wrapped + turns * this.wrapS : wrapped;
      this.data.set(rows.subarray(i, i + this.width), this.head * this.width);
      this.times[this.head] = this.lastS;
      this.head = (this.head + 1) % this.capacity;
      this.held = Math.min(this.held + 1, this.capacity);
    }
    this.heardMs = this.kept > 0 ? this.keptMs : performance.now();
    this.kept -= rows.length / this.width;
  }

  /** Where the i-th oldest row is. @param {number} i */
  slot(i) {
    const slot = this.head - this.held + i;
    return slot < 0 ? slot + this.capacity : slot;
  }

  /** @param {number} i the i-th oldest @param {string} column */
  get(i, column) {
    return this.data[this.slot(i) * this.width + this.at[column]];
  }

  /** The newest figure, NaN if there is none. @param {string} column */
  newest(column) {
    return this.held && column in this.at ? this.get(this.held - 1, column) : NaN;
  }

  /** The newest row in which a figure is known, as the i-th oldest; -1 if there is none. @param {string} column */
  known(column) {
    let i = column in this.at ? this.held - 1 : -1;
    while (i >= 0 && Number.isNaN(this.get(i, column))) i -= 1;
    return i;
  }

  /** The instant now, on the rows' clock: it goes on when nothing comes. */
  nowS() {
    return this.lastS + Math.max(0, performance.now() - this.heardMs) / 1000;
  }

  /** Whether rows come. */
  fresh() {
    return this.held > 0 && performance.now() - this.heardMs < 1000;
  }

  /** The oldest row that is not before an instant. @param {number} fromS */
  since(fromS) {
    let low = 0;
    let high = this.held;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[this.slot(middle)] < fromS) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

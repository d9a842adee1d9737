/** The figures beside a chart: round, few, and still while the data move a little. */

/** 1, 2 or 5 times a power of ten, at least so large. @param {number} least */
export function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  const times = least / power;
  return (times <= 1 ? 1 : times <= 2 ? 2 : times <= 5 ? 5 : 10) * power;
}

const TICKS_MAX = 20;

/**
 * A linear axis around low and high.
 * @param {number} low @param {number} high @param {number} span at least so much is shown
 */
export function linear(low, high, span) {
  // Ticks that are told from each other, however large the figures.
  span = Math.max(span, 1e-6 * Math.max(Math.abs(low), Math.abs(high)));
  const lack = span - (high - low);
  if (lack > 0) {
    // What does not go below zero is not shown below it.
    const below = low >= 0 ? Math.min(low, lack / 2) : lack / 2;
    low -= below;
    high += lack - below;
  }
  const step = roundStep((high - low) / 3);
  const from = Math.floor(low / step + 1e-9);
  const to = Math.max(from + 1, Math.ceil(high / step - 1e-9));
  const ticks = [];
  for (let k = 0; k <= Math.min(to - from, TICKS_MAX); k++) ticks.push((from + k) * step);
  const label = (/** @type {number} */ v) => {
    if (step >= 1e5 || step < 1e-5) return v === 0 ? "0" : v.toExponential(0);
    return v.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "−");
  };
  const bottom = from * step;
  const extent = (to - from) * step;
  return { ticks, label, place: (/** @type {number} */ v) => (v - bottom) / extent };
}

const LEAST = 1e-9;

/**
 * A logarithmic axis; what is not positive is at its bottom.
 * @param {number} low @param {number} high
 */
export function logarithmic(low, high) {
  const from = Math.floor(Math.log10(Math.max(low, LEAST)));
  const to = Math.max(from + 1, Math.ceil(Math.log10(Math.max(high, LEAST))));
  const each = Math.ceil((to - from) / 4);
  const ticks = [];
  for (let k = from; k <= to; k += each) ticks.push(10 ** k);
  const label = (/** @type {number} */ v) => {
    if (v < 1.5 * LEAST) return "≤1e−9";
    const power = Math.round(Math.log10(v));
    return power >= -2 && power <= 3 ? String(Number(v.toPrecision(1))) : `1e${power}`.replace("-", "−");
  };
  return { ticks, label, place: (/** @type {number} */ v) => (Math.log10(Math.max(v, 10 ** from)) - from) / (to - from) };
}

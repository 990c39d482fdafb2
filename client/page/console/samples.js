// Samples of rows of numbers.

import { STRIDE_LANDMARK } from "./scene_data.js";

export const SHOWN = [0.02, 0.98]; // the quantiles of landmarks that the first view holds, and of deviations that colours tell

/** The values below which these shares of a column lie. */
export function quantiles(numbers, axis, shares, stride = STRIDE_LANDMARK) {
  const values = Float32Array.from({ length: numbers.length / stride }, (_, i) => numbers[i * stride + axis]).sort();
  return shares.map((share) => values[Math.round(share * (values.length - 1))] ?? 0);
}

/** A random order of so many. */
export function shuffledOrder(count) {
  const order = Uint32Array.from({ length: count }, (_, i) => i);
  for (let i = count - 1; i > 0; i--) {
    const other = Math.floor(Math.random() * (i + 1));
    [order[i], order[other]] = [order[other], order[i]];
  }
  return order;
}

/** Rows of `stride` numbers in another order. */
export function inOrder(numbers, stride, order) {
  const ordered = new numbers.constructor(numbers.length);
  order.forEach((row, i) => {
    ordered.set(numbers.subarray(row * stride, (row + 1) * stride), i * stride);
  });
  return ordered;
}

/** Rows of `stride` numbers, of which the first three are a position, turned by a rotation; `kept` numbers of each. */
export function inOtherAxes(numbers, stride, R, kept = stride) {
  const turned = new Float32Array((numbers.length / stride) * kept);
  for (let from = 0, to = 0; from < numbers.length; from += stride, to += kept) {
    for (let i = 0; i < kept; i++) {
      const [a, b, c] = R[i] ?? [];
      turned[to + i] = i < 3 ? a * numbers[from] + b * numbers[from + 1] + c * numbers[from + 2] : numbers[from + i];
    }
  }
  return turned;
}

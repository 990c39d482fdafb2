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

// How right a map is at a place: what it expects of its views nearby, which it measured itself.

import { STRIDE_VIEW } from "./scene_data.js";

const NEAR_M = 0.7; // over which views count, standard deviation
const FARTHEST_M = 3; // from the nearest view, beyond which nothing is known
const TURN_PER_M = 1 / 40; // degrees of turn that count as much as a metre

/**
 * The view that is nearest to a place and direction on the floor, and how right a camera there is expected to be [m], null
 * where that is not known: `{view, error}`; null where no view is near.
 * @param {Float32Array} views as `readScene` gives them
 * @param {(number | null)[]} errors what the map expects of each view, m
 * @param {number[]} place x and y
 * @param {number} degrees where the camera looks
 */
export function rightness(views, errors, [x, y], degrees) {
  let [best, least] = [-1, Infinity];
  for (let i = 0; i < views.length / STRIDE_VIEW; i++) {
    const [vx, vy, , hx, hy] = views.subarray(i * STRIDE_VIEW, (i + 1) * STRIDE_VIEW);
    const off = Math.abs((((Math.atan2(hy, hx) * 180) / Math.PI - degrees + 540) % 360) - 180);
    const apart = Math.hypot(vx - x, vy - y) + off * TURN_PER_M;
    if (apart < least) [best, least] = [i, apart];
  }
  if (best < 0) return null;
  const error = errorAt(views, errors, x, y);
  return { view: best, error };
}

/** The expected error [m] around a place: a mean of those of the views nearby, or null where none is near. */
export function errorAt(views, errors, x, y) {
  let [sum, weights, nearest] = [0, 0, Infinity];
  for (let i = 0; i < errors.length && i * STRIDE_VIEW < views.length; i++) {
    const error = errors[i];
    if (error === null) continue;
    const apart = Math.hypot(views[i * STRIDE_VIEW] - x, views[i * STRIDE_VIEW + 1] - y);
    const weight = Math.exp(-(apart ** 2) / (2 * NEAR_M ** 2)) + 1e-9;
    nearest = Math.min(nearest, apart);
    sum += weight * error;
    weights += weight;
  }
  return nearest <= FARTHEST_M && weights ? sum / weights : null;
}

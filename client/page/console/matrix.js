// 4 × 4 matrices of views, as four rows.

import { carried } from "../../js/poses.js";

/** The sixteen numbers column by column, as WebGL takes them. */
export const columns = (M) => Float32Array.from({ length: 16 }, (_, k) => M[k % 4][k >> 2]);

/** Eye coordinates → clip coordinates; `fov` is the height's angle in radians. */
export function perspective(fov, aspect, near, far) {
  const f = 1 / Math.tan(fov / 2);
  const depth = near - far;
  return [
    [f / aspect, 0, 0, 0],
    [0, f, 0, 0],
    [0, 0, (far + near) / depth, (2 * far * near) / depth],
    [0, 0, -1, 0],
  ];
}

/** Eye coordinates → clip coordinates without perspective, of a picture so wide and high. */
export function orthographic(width, height) {
  const scales = [2 / width, 2 / height, -1, 1];
  return scales.map((scale, i) => scales.map((_, j) => (i === j ? scale : 0)));
}

/** World coordinates (z up) → eye coordinates. */
export function lookAt(eye, target) {
  const back = unit(eye.map((value, i) => value - target[i]));
  const right = unit(cross([0, 0, 1], back));
  const axes = [right, cross(back, right), back];
  return [...axes.map((axis) => [...axis, -dot(axis, eye)]), [0, 0, 0, 1]];
}

/** Distance from `target`, seen along the unit vector `away`, at which `points` just fill `share` of the picture. */
export function fittingDistance(points, target, away, fov, aspect, share = 0.94) {
  const view = lookAt(
    target.map((value, i) => value + away[i]),
    target,
  );
  const high = share * Math.tan(fov / 2);
  const needed = points.map((point) => {
    const [right, up, back] = carried(view, point);
    return back + 1 + Math.max(Math.abs(right) / aspect, Math.abs(up)) / high;
  });
  return Math.max(...needed);
}

/** A rotation of three rows as a matrix. */
export const rotation = (R) => [...R.map((row) => [...row, 0]), [0, 0, 0, 1]];

/** A point in clip coordinates: x and y from -1 to 1 within the picture, and w, positive in front of the camera. */
export function project(matrix, [x, y, z]) {
  const [cx, cy, , w] = matrix.map((row) => row[0] * x + row[1] * y + row[2] * z + row[3]);
  return [cx / w, cy / w, w];
}

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** @type {(u: number[], v: number[]) => number[]} */
export const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

const unit = (v) => v.map((value) => value / (Math.hypot(...v) || 1));

// 4 × 4 matrices in column order, as WebGL takes them.

/** a · b */
export function multiply(a, b) {
  return Float32Array.from({ length: 16 }, (_, i) => {
    const [column, row] = [i >> 2, i & 3];
    return [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * k + row] * b[4 * column + k], 0);
  });
}

/** Eye coordinates → clip coordinates; `fov` is the height's angle in radians. */
export function perspective(fov, aspect, near, far) {
  const f = 1 / Math.tan(fov / 2);
  const depth = near - far;
  return [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / depth, -1, 0, 0, (2 * far * near) / depth, 0];
}

/** Eye coordinates → clip coordinates without perspective, of a picture so wide and high. */
export function orthographic(width, height) {
  return [2 / width, 0, 0, 0, 0, 2 / height, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1];
}

/** World coordinates (z up) → eye coordinates. */
export function lookAt(eye, target) {
  const back = unit(eye.map((value, i) => value - target[i]));
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  const shift = [right, up, back].map((axis) => -dot(axis, eye));
  return [0, 1, 2].flatMap((i) => [right[i], up[i], back[i], 0]).concat(shift, 1);
}

/** Distance from `target`, seen along the unit vector `away`, at which `points` just fill `share` of the picture. */
export function fittingDistance(points, target, away, fov, aspect, share = 0.94) {
  const view = lookAt(
    target.map((value, i) => value + away[i]),
    target,
  );
  const high = share * Math.tan(fov / 2);
  const needed = points.map(([x, y, z]) => {
    const [right, up, back] = [0, 1, 2].map((i) => view[i] * x + view[4 + i] * y + view[8 + i] * z + view[12 + i]);
    return back + 1 + Math.max(Math.abs(right) / aspect, Math.abs(up)) / high;
  });
  return Math.max(...needed);
}

/** A rotation of three rows as a matrix. */
export function rotation(R) {
  return [0, 1, 2].flatMap((column) => [R[0][column], R[1][column], R[2][column], 0]).concat(0, 0, 0, 1);
}

/** A point in clip coordinates: x and y from -1 to 1 within the picture, and w, positive in front of the camera. */
export function project(matrix, [x, y, z]) {
  const [cx, cy, , w] = [0, 1, 2, 3].map(
    (row) => matrix[row] * x + matrix[4 + row] * y + matrix[8 + row] * z + matrix[12 + row],
  );
  return [cx / w, cy / w, w];
}

const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];
const unit = (v) => v.map((value) => value / (Math.hypot(...v) || 1));

// Poses and intrinsics between the conventions of the service, of AR frameworks and of game engines.
//
// A pose is a rigid transform as four rows of four numbers, `T_to_from`. The service's cameras look along z, with x to the
// right and y down (OpenCV); its maps are right-handed, with z up and metres.

/** How a framework lays its axes. */
export const Axes = Object.freeze({
  /** Right-handed; the camera looks along z, x right, y down. */
  OPENCV: "opencv",
  /** Right-handed; the camera looks along −z, x right, y up: WebXR, ARKit, ARCore, three.js. */
  OPENGL: "opengl",
  /** Left-handed, y up; the camera looks along z, x right, y up: Unity. */
  UNITY: "unity",
});

/** @type {Set<string>} */
const AXES = new Set(Object.values(Axes));
const FLIP = [1, -1, -1];

/** The product of two transforms. */
export function multiply(A, B) {
  return A.map((row) => [0, 1, 2, 3].map((j) => row.reduce((sum, value, k) => sum + value * B[k][j], 0)));
}

/** The inverse of a rigid transform. */
export function inverse(T) {
  const R = [0, 1, 2].map((i) => [0, 1, 2].map((j) => T[j][i]));
  const t = R.map((row) => -row.reduce((sum, value, k) => sum + value * T[k][3], 0));
  return [...R.map((row, i) => [...row, t[i]]), [0, 0, 0, 1]];
}

/**
 * A point that a transform takes to another frame.
 * @param {number[][]} T
 * @param {Iterable<number>} point
 */
export function carried(T, [x, y, z]) {
  return [0, 1, 2].map((i) => T[i][0] * x + T[i][1] * y + T[i][2] * z + T[i][3]);
}

/** The rotation of a quaternion x, y, z, w of any length, as three rows. */
export function rotationOf(quaternion) {
  const length = Math.hypot(...quaternion) || 1;
  const [x, y, z, w] = quaternion.map((value) => value / length);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
    [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
    [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
  ];
}

/**
 * The pose of a camera in a session's frame, by the service's axes. A left-handed session becomes the right-handed one
 * whose z axis is turned round.
 * @param {number[][] | ArrayLike<number>} pose four rows, or sixteen numbers column by column, as WebXR and ARKit give them
 * @param {string} axes of {@link Axes}
 * @returns {number[][]} T_session_camera
 * @throws {RangeError} it is no rigid motion, or the axes are unknown
 */
export function toOpenCV(pose, axes) {
  let T = rows(pose);
  if (!AXES.has(axes)) throw new RangeError(`There are no axes "${axes}".`);
  if (axes === Axes.UNITY) T = T.map((row, i) => row.map((value, j) => ((i === 2) !== (j === 2) ? -value : value)));
  if (axes !== Axes.OPENCV) T = T.map((row) => row.map((value, j) => (j < 3 ? value * FLIP[j] : value)));
  check(T);
  return T;
}

/**
 * The pose of the camera whose picture is another's, turned clockwise by quarters: phones give poses for the display, and
 * pictures as the sensor lies.
 */
export function turned(T_session_camera, quarters) {
  const [c, s] = [
    [1, 0],
    [0, 1],
    [-1, 0],
    [0, -1],
  ][((quarters % 4) + 4) % 4];
  return multiply(T_session_camera, [
    [c, s, 0, 0],
    [-s, c, 0, 0],
    [0, 0, 1, 0],
    [0, 0, 0, 1],
  ]);
}

/**
 * The intrinsics of a picture that is cropped out of a sensor's, and then scaled.
 * @param {{width: number, height: number, fx: number, fy: number, cx: number, cy: number}} sensor
 * @param {{crop?: {x: number, y: number, width: number, height: number}, width?: number, height?: number}} picture the part in
 *   pixels of the sensor, by default all; and the size that it was scaled to
 */
export function camera(sensor, { crop = { x: 0, y: 0, ...size(sensor) }, ...scaled } = {}) {
  const { width, height } = { ...size(crop), ...scaled };
  const [x, y] = [width / crop.width, height / crop.height];
  return {
    ...sensor,
    width,
    height,
    fx: sensor.fx * x,
    fy: sensor.fy * y,
    cx: (sensor.cx - crop.x + 0.5) * x - 0.5,
    cy: (sensor.cy - crop.y + 0.5) * y - 0.5,
  };
}

/**
 * The intrinsics of a view's raw picture by the projection matrix of WebXR or OpenGL, for the picture with its first row at
 * the top.
 * @param {ArrayLike<number>} matrix sixteen numbers, column by column
 * @param {number} width
 * @param {number} height
 */
export function cameraOfProjection(matrix, width, height) {
  return {
    width,
    height,
    fx: (matrix[0] * width) / 2,
    fy: (matrix[5] * height) / 2,
    cx: ((1 - matrix[8]) * width) / 2 - 0.5,
    cy: ((1 + matrix[9]) * height) / 2 - 0.5,
  };
}

/** The angle between two rotations, in radians. */
export function angleBetween(A, B) {
  let trace = 0;
  for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) trace += A[i][j] * B[i][j];
  return Math.acos(Math.min(1, Math.max(-1, (trace - 1) / 2)));
}

/** The mean of rotations near each other: each three rows of at least three numbers, and its weight. */
export function meanRotation(rotations, weights) {
  const mean = [0, 0, 0, 0];
  const first = quaternion(rotations[0]);
  rotations.forEach((R, k) => {
    const q = quaternion(R);
    const sign = q.reduce((sum, value, i) => sum + value * first[i], 0) < 0 ? -1 : 1;
    for (let i = 0; i < 4; i++) mean[i] += sign * weights[k] * q[i];
  });
  return rotationOf(mean);
}

/** The quaternion x, y, z, w of a rotation: of four ways to compute it, that with the largest divisor. */
function quaternion(R) {
  const squares = [1 + R[0][0] - R[1][1] - R[2][2], 1 - R[0][0] + R[1][1] - R[2][2], 1 - R[0][0] - R[1][1] + R[2][2]];
  squares.push(1 + R[0][0] + R[1][1] + R[2][2]);
  const k = squares.indexOf(Math.max(...squares));
  const s = 2 * Math.sqrt(squares[k]);
  const [a, b, c] = [R[2][1] - R[1][2], R[0][2] - R[2][0], R[1][0] - R[0][1]];
  const [d, e, f] = [R[0][1] + R[1][0], R[0][2] + R[2][0], R[1][2] + R[2][1]];
  const parts = [
    [squares[0], d, e, a],
    [d, squares[1], f, b],
    [e, f, squares[2], c],
    [a, b, c, squares[3]],
  ][k];
  return parts.map((value) => value / s);
}

function rows(pose) {
  if (pose.length === 4) return Array.from(pose, (row) => Array.from(row));
  if (pose.length !== 16) throw new RangeError("A pose has four rows of four numbers, or sixteen numbers.");
  return [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((j) => pose[4 * j + i]));
}

function check(T) {
  const finite = T.every((row) => row.length === 4 && row.every(Number.isFinite));
  const [a, b, c] = [0, 1, 2].map((j) => T.slice(0, 3).map((row) => row[j]));
  const dot = (u, v) => u.reduce((sum, value, i) => sum + value * v[i], 0);
  const volume = dot(a, [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]);
  const off = [dot(a, a) - 1, dot(b, b) - 1, dot(c, c) - 1, dot(a, b), dot(b, c), dot(a, c), volume - 1];
  if (!finite || !off.every((value) => Math.abs(value) < 1e-3)) throw new RangeError("A pose is not a rigid motion.");
}

const size = ({ width, height }) => ({ width, height });

// The surfaces of a room, as they are drawn: shaded, seen from the free side only, so that one looks into it from outside.

import { multiply } from "../../js/poses.js";
import { lookAt, orthographic, project } from "./matrix.js";
import { inOtherAxes } from "./samples.js";

const LIGHT = [0.35, 0.2, 0.91]; // where it comes from, z up
const SHADED = [0.6, 0.46]; // least brightness, and what full light adds
const SIDES = 8; // directions that are tried for the one that shows most
const TILT = 0.62; // rad
const MARGIN = 1.04;
const PLAN_PX = 700; // of the longer side of a plan
const TRIMMED = [0.004, 0.996]; // quantiles of the vertices that a picture holds
const LEVEL = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];

/** What is drawn of a room (of `readRoom`): `{positions, triangles, tints, areas}`, in level axes by the rotation `R`. */
export function surfaces({ positions, faces, colours }, R = LEVEL) {
  const level = inOtherAxes(positions, 3, R);
  const triangles = new Uint32Array((faces.length / 4) * 6);
  for (let i = 0, to = 0; i < faces.length; i += 4)
    for (const corner of [0, 1, 2, 0, 2, 3]) triangles[to++] = faces[i + corner];
  const normals = new Float32Array(positions.length);
  for (let i = 0; i < faces.length; i += 4) {
    const [a, b, c, d] = faces.subarray(i, i + 4);
    const across = crossOf(level, a, c, b, d);
    for (const corner of [a, b, c, d]) for (let k = 0; k < 3; k++) normals[3 * corner + k] += across[k];
  }
  const tints = new Uint8Array(colours.length);
  for (let i = 0; i < colours.length; i += 3) {
    const size = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    const lit = (normals[i] * LIGHT[0] + normals[i + 1] * LIGHT[1] + normals[i + 2] * LIGHT[2]) / size;
    for (let k = 0; k < 3; k++)
      tints[i + k] = Math.min(255, colours[i + k] * (SHADED[0] + SHADED[1] * Math.max(0, lit)));
  }
  return { positions, level, triangles, tints, normals };
}

/** The direction [rad] from which most of a room's walls are seen. */
export function bestTurn({ normals }) {
  const shown = Array.from({ length: SIDES }, (_, side) => {
    const angle = (2 * Math.PI * (side + 0.5)) / SIDES;
    const [x, y] = [Math.cos(angle), Math.sin(angle)];
    let sum = 0;
    for (let i = 0; i < normals.length; i += 3) sum += Math.max(0, normals[i] * x + normals[i + 1] * y);
    return sum;
  });
  return (2 * Math.PI * (shown.indexOf(Math.max(...shown)) + 0.5)) / SIDES;
}

/** The bounds of a room's surfaces along each level axis, `[[least, most], …]`. */
export function boundsOf({ level }) {
  return [0, 1, 2].map((axis) => {
    const values = Float32Array.from({ length: level.length / 3 }, (_, i) => level[3 * i + axis]).sort();
    return TRIMMED.map((share) => values[Math.round(share * (values.length - 1))] ?? 0);
  });
}

/** Draw a room onto a canvas of a size in pixels, from above one corner. */
export function drawRoom(canvas, room, width, height) {
  const bounds = boundsOf(room);
  const middle = bounds.map(([low, high]) => (low + high) / 2);
  const turn = bestTurn(room);
  const eye = [Math.cos(turn) * Math.cos(TILT), Math.sin(turn) * Math.cos(TILT), Math.sin(TILT)];
  /** @type {(corner: any) => number[]} */
  const seen = (corner) => project(view, corner);
  const view = lookAt(
    middle.map((value, i) => value + eye[i]),
    middle,
  );
  const corners = Array.from({ length: 8 }, (_, i) => bounds.map((ends, axis) => ends[(i >> axis) & 1]));
  const [across, up] = [0, 1].map((axis) => 2 * Math.max(...corners.map((corner) => Math.abs(seen(corner)[axis]))));
  const scale = MARGIN * Math.max(across / width, up / height);
  paint(canvas, room, multiply(orthographic(scale * width, scale * height), view), width, height);
}

/**
 * A room from above as `drawFloorPlan` takes it: `{image, inColour, corner, turn, perPixel}`, in level axes with north up.
 */
export function planOf(room) {
  const [[west, east], [south, north]] = boundsOf(room);
  const perPixel = (MARGIN * Math.max(east - west, north - south, 0.1)) / PLAN_PX;
  const [width, height] = [east - west, north - south].map((span) =>
    Math.max(1, Math.ceil((MARGIN * span) / perPixel)),
  );
  const middle = [(west + east) / 2, (south + north) / 2];
  const image = document.createElement("canvas");
  const down = multiply(orthographic(width * perPixel, height * perPixel), [
    [1, 0, 0, -middle[0]],
    [0, 1, 0, -middle[1]],
    [0, 0, 1, 0],
    [0, 0, 0, 1],
  ]);
  paint(image, room, down, width, height);
  return {
    image,
    inColour: true,
    corner: [middle[0] - (width * perPixel) / 2, middle[1] - (height * perPixel) / 2],
    turn: 0,
    perPixel,
  };
}

/** Fill the triangles that face the eye, the farthest first. */
function paint(canvas, { level, triangles, tints }, [across, up, away], width, height) {
  Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  const count = level.length / 3;
  const [x, y, depth] = [new Float32Array(count), new Float32Array(count), new Float32Array(count)];
  for (let i = 0; i < count; i++) {
    const [a, b, c] = level.subarray(3 * i, 3 * i + 3);
    x[i] = (0.5 + 0.5 * (across[0] * a + across[1] * b + across[2] * c + across[3])) * width;
    y[i] = (0.5 - 0.5 * (up[0] * a + up[1] * b + up[2] * c + up[3])) * height;
    depth[i] = away[0] * a + away[1] * b + away[2] * c + away[3];
  }
  const seen = [];
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = triangles.subarray(i, i + 3);
    if ((x[b] - x[a]) * (y[c] - y[a]) < (x[c] - x[a]) * (y[b] - y[a])) seen.push(i);
  }
  seen.sort((i, j) => depth[triangles[j]] - depth[triangles[i]]);
  context.lineWidth = 0.7; // closes the seams between neighbours
  for (const i of seen) {
    const [a, b, c] = triangles.subarray(i, i + 3);
    context.fillStyle = context.strokeStyle = `rgb(${tints[3 * a]} ${tints[3 * a + 1]} ${tints[3 * a + 2]})`;
    context.beginPath();
    context.moveTo(x[a], y[a]);
    context.lineTo(x[b], y[b]);
    context.lineTo(x[c], y[c]);
    context.closePath();
    context.fill();
    context.stroke();
  }
}

/** Cross product of the ways from vertex `a` to `c` and from `b` to `d`. */
function crossOf(positions, a, c, b, d) {
  const way = (from, to) => [0, 1, 2].map((k) => positions[3 * to + k] - positions[3 * from + k]);
  const [[x, y, z], [u, v, w]] = [way(a, c), way(b, d)];
  return [y * w - z * v, z * u - x * w, x * v - y * u];
}

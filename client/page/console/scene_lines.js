// What is drawn of a map as lines: each function gives the ends of lines, three numbers each, in the map's frame.

import { carried } from "../../js/poses.js";
import { quantiles, SHOWN } from "./samples.js";
import { STRIDE_VIEW } from "./scene_data.js";

const HEADING_LENGTH = 0.25; // m, of a view's tick
const FRUSTUM = 0.5; // m, how far the drawn camera reaches
const BAND = [-0.015, 0, 0.015]; // m, above a way
const SIGMAS = 2; // that an ellipsoid reaches
const CORNERS = 24; // of each of its outlines
const MAX_FLOOR = 10_000; // square metres that are drawn

/** Lines between consecutive views of one walk. */
export function walk(views) {
  const lines = [];
  for (let i = STRIDE_VIEW; i < views.length; i += STRIDE_VIEW) {
    const before = i - STRIDE_VIEW;
    if (views[i + 6] === views[before + 6])
      lines.push(...views.subarray(before, before + 3), ...views.subarray(i, i + 3));
  }
  return lines;
}

/** The views of a walk as a second reconstruction has them, which drift from it where the two disagree. */
export function secondViews(views, second) {
  const others = views.slice();
  for (let k = 0; 3 * k < second.length; k++) others.set(second.subarray(3 * k, 3 * k + 3), k * STRIDE_VIEW);
  return others.filter((_, i) => !Number.isNaN(others[i - (i % STRIDE_VIEW)]));
}

/** Lines from each view to where a second reconstruction has it. */
export function apart(views, second) {
  const lines = [];
  for (let k = 0; 3 * k < second.length; k++) {
    const other = second.subarray(3 * k, 3 * k + 3);
    if (!Number.isNaN(other[0])) lines.push(...views.subarray(k * STRIDE_VIEW, k * STRIDE_VIEW + 3), ...other);
  }
  return lines;
}

/** A grid of square metres, at the height of the lowest landmarks. */
export function floor(landmarks) {
  if (!landmarks.length) return [];
  return squares([...[0, 1].map((axis) => quantiles(landmarks, axis, SHOWN)), [floorOf(landmarks)]]);
}

/**
 * Square metres over a rectangle at a height.
 * @param {number[][]} box `[[west, east], [south, north], [height]]`
 */
export function squares(box) {
  const [across, along, [z]] = box;
  const [[west, east], [south, north]] = [across, along].map((ends) => ends.map(Math.round));
  if ((east - west) * (north - south) > MAX_FLOOR) return [];
  const lines = [];
  for (let x = west; x <= east; x++) lines.push(x, south, z, x, north, z);
  for (let y = south; y <= north; y++) lines.push(west, y, z, east, y, z);
  return lines;
}

/** The height of the lowest landmarks. */
export const floorOf = (landmarks) => (landmarks.length ? quantiles(landmarks, 2, SHOWN)[0] : 0);

export function outlines(areas, z) {
  return areas.flatMap(({ outline }) =>
    outline.flatMap((corner, i) => [...corner, z, ...outline[(i + 1) % outline.length], z]),
  );
}

export function headings(views) {
  const lines = [];
  for (let i = 0; i < views.length; i += STRIDE_VIEW) {
    const position = views.subarray(i, i + 3);
    lines.push(...position, ...position.map((value, axis) => value + HEADING_LENGTH * views[i + 3 + axis]));
  }
  return lines;
}

export function segments(positions) {
  return positions.slice(1).flatMap((position, i) => [...positions[i], ...position]);
}

/** A way that stands out from other lines: one above the other. */
export const band = (positions) => BAND.flatMap((by) => segments(positions.map(([x, y, z]) => [x, y, z + by])));

/**
 * A pyramid whose tip is the camera, and whose base has the picture's shape.
 * @param {number[][]} T
 * @param {number[]} extents
 */
export function frustum(T, [across, down]) {
  const point = (...at) => carried(T, at);
  const [w, tall, d] = [across * FRUSTUM, down * FRUSTUM, FRUSTUM];
  const tip = point(0, 0, 0);
  const corners = [point(-w, -tall, d), point(w, -tall, d), point(w, tall, d), point(-w, tall, d)];
  const above = point(0, -1.5 * tall, d);
  const edges = corners.flatMap((corner, i) => [...tip, ...corner, ...corner, ...corners[(i + 1) % 4]]);
  return [...edges, ...corners[0], ...above, ...above, ...corners[1]];
}

/** Three short lines through a point. */
export function cross(position, reach) {
  return [0, 1, 2].flatMap((axis) =>
    [-reach, reach].flatMap((by) => position.map((value, i) => (i === axis ? value + by : value))),
  );
}

/** Three outlines of the ellipsoid within which a position is, `covariance` (the upper left 3 × 3 of it) being its own. */
export function ellipsoid({ position, covariance }) {
  const L = cholesky(covariance);
  const corner = (plane, i) => {
    const angle = (2 * Math.PI * i) / CORNERS;
    const u = [0, 0, 0];
    u[plane] = SIGMAS * Math.cos(angle);
    u[(plane + 1) % 3] = SIGMAS * Math.sin(angle);
    return position.map((value, row) => value + L[row].reduce((sum, factor, k) => sum + factor * u[k], 0));
  };
  return [0, 1, 2].flatMap((plane) =>
    Array.from({ length: CORNERS }, (_, i) => [...corner(plane, i), ...corner(plane, i + 1)]).flat(),
  );
}

/** The lower triangle L of L Lᵀ, the upper left 3 × 3 of a covariance. */
function cholesky(A) {
  const L = [0, 1, 2].map(() => [0, 0, 0]);
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j <= i; j++) {
      const rest = A[i][j] - L[i].reduce((sum, value, k) => sum + (k < j ? value * L[j][k] : 0), 0);
      L[i][j] = i === j ? Math.sqrt(Math.max(rest, 0)) : L[j][j] && rest / L[j][j];
    }
  }
  return L;
}

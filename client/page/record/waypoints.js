// Measured points of the walk: `{name, time, position}`. `time` is null until the point is marked; `position` holds three
// numbers or nulls, in metres.

import { t } from "../shared/text.js";

export const FEWEST = 3; // that fix a map's frame
const END = "E"; // the name of the walk's end
const DOUBLE_TAP_S = 1; // within which a second tap is taken for the first
const LEAST_SPREAD = 0.02; // of the points across the line through them, to their extent along it

/** The points of a walk as the paper has it: W1, W2, W3 and E, the end. */
export function planned() {
  return ["W1", "W2", "W3", END].map(empty);
}

/** A point that is not marked or measured yet. */
export function empty(name) {
  return { name, time: null, position: [null, null, null] };
}

/** A name that none of the waypoints has: W4, W5, … */
export function freeName(waypoints) {
  const names = new Set(waypoints.map((waypoint) => waypoint.name));
  let number = 1;
  while (names.has(`W${number}`)) number++;
  return `W${number}`;
}

/** The row of the point that is marked next; their number where a new one is to be added. */
export function nextRow(waypoints) {
  const row = waypoints.findIndex((waypoint) => waypoint.time === null);
  return row < 0 ? waypoints.length : row;
}

/** The waypoints with one more, before the end of the walk while that is still to come. */
export function added(waypoints) {
  const end = waypoints.findIndex(({ name, time }) => name === END && time === null);
  return waypoints.toSpliced(end < 0 ? waypoints.length : end, 0, empty(freeName(waypoints)));
}

/** The waypoints after the next is marked at `time`; as they were where that is the second tap of a double one. */
export function marked(waypoints, time) {
  if (waypoints.some((waypoint) => waypoint.time !== null && time - waypoint.time < DOUBLE_TAP_S)) return waypoints;
  const row = nextRow(waypoints);
  const waypoint = waypoints[row] ?? empty(freeName(waypoints));
  return waypoints.toSpliced(row, 1, { ...waypoint, time });
}

/** A coordinate as typed, "1.25" or "1,25" → a number; null for anything else. */
export function coordinate(text) {
  const value = text.trim().replace(",", ".");
  return /^[-+]?(\d+\.?\d*|\.\d+)$/.test(value) ? Number(value) : null;
}

/** Those that are marked and measured, in the order of their times. */
export function complete(waypoints) {
  return waypoints
    .filter(({ name, time, position }) => name && time !== null && position.every(Number.isFinite))
    .sort((a, b) => a.time - b.time);
}

/** What keeps the waypoints from fixing the map's frame, as a sentence; null when nothing does. */
export function problem(waypoints) {
  const named = waypoints.map(({ name }) => name);
  const twice = named.find((name, i) => named.indexOf(name) !== i);
  if (twice) return t`Two waypoints are called ${twice}.`;
  const usable = complete(waypoints);
  if (!waypoints.some(({ position }) => position.every(Number.isFinite))) return null; // they are optional
  if (usable.length < FEWEST)
    return t`${usable.length} of at least ${FEWEST} points are marked and measured. Without more the map gets axes of its own.`;
  if (onOneLine(usable.map(({ position }) => position)))
    return t`The waypoints lie on one line, so the rotation about it is not determined. Measure one more off that line, or clear their coordinates.`;
  return null;
}

/** Whether points count as collinear: all are too near to the line through the two that are farthest apart. */
export function onOneLine(points) {
  const pairs = points.flatMap((a, i) => points.slice(i + 1).map((b) => [a, b, distance(a, b)]));
  const [from, to, length] = pairs.reduce((longest, pair) => (pair[2] > longest[2] ? pair : longest));
  return points.every((point) => twiceArea(from, to, point) <= LEAST_SPREAD * length ** 2);
}

const distance = (a, b) => Math.hypot(...a.map((value, i) => value - b[i]));

/** Of the triangle of three points: the longest side times the distance from it. */
function twiceArea(a, b, c) {
  const [u, v] = [b, c].map((point) => point.map((value, i) => value - a[i]));
  return Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
}

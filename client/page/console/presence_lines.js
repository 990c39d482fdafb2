// Where a landmark may be seen from, as lines: a cone about the mean direction it was seen from, cut off at both ends.

import { cross } from "./matrix.js";

const CORNERS = 32; // of a circle
const RAYS = 8; // along the cone's edge
const ARC_STEPS = 16; // across the far end

/**
 * The ends of lines, three numbers each. `feature` is what `/v1/maps/{map}/features/{feature}` answers.
 * @param {{position: number[], direction: number[], half_angle_deg: number, nearest: number, farthest: number}} feature
 */
export function presenceLines({ position, direction, half_angle_deg: degrees, nearest, farthest }) {
  const edge = (degrees * Math.PI) / 180;
  const [across, up] = acrossTo(direction);
  const at = (distance, angle, turn) =>
    position.map((value, i) => {
      const aside = Math.cos(turn) * across[i] + Math.sin(turn) * up[i];
      return value + distance * (Math.cos(angle) * direction[i] + Math.sin(angle) * aside);
    });
  const around = (i, of) => (2 * Math.PI * i) / of;
  const circle = (distance) =>
    range(CORNERS).flatMap((i) => [
      ...at(distance, edge, around(i, CORNERS)),
      ...at(distance, edge, around(i + 1, CORNERS)),
    ]);
  const rays = range(RAYS).flatMap((i) => [
    ...at(nearest, edge, around(i, RAYS)),
    ...at(farthest, edge, around(i, RAYS)),
  ]);
  const arc = (turn) =>
    range(ARC_STEPS).flatMap((i) => [i, i + 1].flatMap((k) => at(farthest, ((2 * k) / ARC_STEPS - 1) * edge, turn)));
  return [...circle(nearest), ...circle(farthest), ...rays, ...arc(0), ...arc(Math.PI / 2)];
}

/**
 * Two unit vectors that are at right angles to one and to each other, the first one level where that can be.
 * @param {number[]} direction
 */
function acrossTo(direction) {
  const [x, y] = direction;
  const level = Math.hypot(x, y);
  const across = level > 1e-6 ? [-y / level, x / level, 0] : [1, 0, 0];
  return [across, cross(direction, across)];
}

const range = (count) => Array.from({ length: count }, (_, i) => i);

// A floor from above: its rooms, the walks, and what is drawn on them.

import { carried } from "../../js/poses.js";
import { resolvedColour } from "../shared/colours.js";
import { drawFloorPlan } from "./plan_view.js";
import { planOf, surfaces } from "./room.js";

const MARGIN = 0.06; // of the canvas on each side
const LEAST_M = 4; // that a canvas shows

/** A room (of `readRoom`) in a site, as `drawFloor` takes it. */
export function placedPlan({ positions, faces, colours }, T) {
  const placed = new Float32Array(positions.length);
  for (let i = 0; i < positions.length; i += 3) placed.set(carried(T, positions.subarray(i, i + 3)), i);
  return planOf(surfaces({ positions: placed, faces, colours }));
}

/** Ends `[[west, east], [south, north]]` of plans and positions, at least so many metres apart. */
export function endsOf(plans, positions, least = LEAST_M) {
  const corners = plans.flatMap(({ corner: [x, y], perPixel, image: { width, height } }) => [
    [x, y],
    [x + width * perPixel, y + height * perPixel],
  ]);
  return [0, 1].map((k) => {
    const values = [...corners, ...positions].map((point) => point[k]);
    const [low, high] = [Math.min(...values), Math.max(...values)];
    const missing = Math.max(0, least - (high - low)) / 2;
    return Number.isFinite(low) ? [low - missing, high + missing] : [-LEAST_M / 2, LEAST_M / 2];
  });
}

/**
 * Draw plans and walks onto a canvas, and what `over(context, place, scale, colour)` draws; `place` takes [x, y] in metres to
 * pixels.
 */
export function drawFloor(canvas, plans, walks, ends, over) {
  const ratio = Math.min(devicePixelRatio, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const colour = (token) => resolvedColour(canvas, token);
  context.fillStyle = colour("--surface");
  context.fillRect(0, 0, width, height);
  const [[west, east], [south, north]] = ends;
  const scale = (1 - 2 * MARGIN) * Math.min(width / (east - west), height / (north - south));
  /** @returns {[number, number]} */
  const place = ([x, y]) => [
    width / 2 + scale * (x - (west + east) / 2),
    height / 2 - scale * (y - (south + north) / 2),
  ];
  for (const plan of plans) drawFloorPlan(context, plan, place(plan.corner), scale, colour("--muted"));
  context.strokeStyle = colour("--muted");
  context.lineWidth = 1;
  for (const walk of walks) {
    context.beginPath();
    for (const point of walk) context.lineTo(...place(point));
    context.stroke();
  }
  over(context, place, scale, colour);
}

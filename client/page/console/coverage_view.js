// Where a map works: places from above, and at each a wedge for every direction that a camera may look in.

import { resolvedColour } from "../shared/colours.js";
import { fill, h } from "../shared/dom.js";
import { coordinates, t } from "../shared/text.js";
import { planUnder } from "./floor_plan.js";
import { length } from "./format.js";
import { cross, dot } from "./matrix.js";
import { drawFloorPlan } from "./plan_view.js";

// The least number of landmarks in view, as a share of what suffices, and its colour: from plenty to none. Blue against
// orange can be distinguished by everyone.
const LEVELS = [
  [4, "#08519c"],
  [2, "#3182bd"],
  [1, "#7fb8dd"],
  [0.5, "#fdcb8a"],
  [0.25, "#f08a4b"],
  [0, "#c23b22"],
];
const RADIUS = 0.47; // of a rose, in steps
const MARGIN_STEPS = 1.2; // around the roses
const MAX_HEIGHT = 560; // px
const BAR_HEIGHT = 28; // px, below the roses
const BAR_SHARE = 0.25; // of the width at most
const NEAR_M = 0.5; // within which places count together, standard deviation
const GLOW_M = 0.4; // around the place of a request that failed
const GLOW_PX = 10; // at the least
const GLOW_ALPHA = 0.12;
const MOST_GLOW = 0.6;
const LEVEL = 1e-6; // how far an axis may be from the map's own
const BARS_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100];

/**
 * The drawing with its legend and what is said of the place pointed at. `coverage` is what `/v1/maps/{map}/coverage`
 * answers; `look(T_map_camera, place, degrees)` hears of a place and direction that was clicked; `rightAt(place, degrees)`
 * says how right a camera there is, in metres, or null.
 */
export function coverageView(coverage, map, signal, look, rightAt, failures = []) {
  if (!coverage.cells.length)
    return h("p", { class: "muted" }, t`The map has no views, so it is unknown where it works.`);
  const canvas = h("canvas", { class: "coverage", tabindex: 0, role: "img", "aria-label": summary(coverage) });
  const said = h(
    "p",
    { class: "small", role: "status" },
    t`Point at a place, or use the arrow keys; a click shows it in the room.`,
  );
  const unit = map.scale === "metric" ? "m" : t`units`;
  const rose = { cell: null, heading: 0 };
  const next = nextWalk(coverage);
  let plan = /** @type {any} */ (null);
  const draw = () => drawCoverage(canvas, coverage, map, unit, rose, next, failures, plan);
  if (isLevel(coverage))
    planUnder(map, signal).then(
      (kept) => {
        plan = kept;
        if (plan && canvas.isConnected) draw();
      },
      () => {}, // without it, the drawing is as right as before
    );
  const choose = (cell, heading) => {
    Object.assign(rose, { cell, heading });
    said.textContent = sayPlace(coverage, cell, heading, unit, rightAt(...spotOf(coverage, cell, heading)));
    draw();
  };
  canvas.addEventListener("pointermove", (event) => {
    const found = roseAt(canvas, coverage, event.offsetX, event.offsetY);
    if (found) choose(found.cell, found.heading);
  });
  const lookAt = () => look(cameraAt(coverage, rose.cell, rose.heading), ...spotOf(coverage, rose.cell, rose.heading));
  canvas.addEventListener("click", () => rose.cell !== null && lookAt());
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && rose.cell !== null) lookAt();
    else {
      const next = moved(coverage, rose, event.key);
      if (!next) return;
      choose(next.cell, next.heading);
    }
    event.preventDefault();
  });
  const observer = new ResizeObserver(draw);
  observer.observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw, { signal });
  signal.addEventListener("abort", () => observer.disconnect());
  return h(
    "div",
    { class: "card stack" },
    h("p", {}, summary(coverage)),
    canvas,
    said,
    legend(coverage.sufficient),
    map.keeps_failures && h("p", { class: "small" }, sayFailures(failures)),
    next && walkNext(next, map, unit),
  );
}

/**
 * What to walk next, with a link that the recorder takes up.
 * @param {{degrees: number, position: number[]}} next
 */
function walkNext({ degrees, position: [x, y] }, map, unit) {
  const place = [x.toFixed(1), y.toFixed(1), degrees.toFixed(0)];
  return h(
    "div",
    { class: "row spread" },
    h(
      "p",
      {},
      h("strong", {}, t`Walk here next:`),
      " ",
      t`around ${coordinates([x, y], 1)} ${unit}, looking to ${place[2]}° (the arrow).`,
    ),
    h("a", { class: "button", href: `record#/next/${encodeURIComponent(map.name)}/${place.join(",")}` }, t`Record it`),
  );
}

/** One sentence on the whole. */
export function summary({ share_sufficient: share, positions_sufficient: places, sufficient }) {
  const [all, some] = [share, places].map((value) => Math.round(100 * value));
  return t`Near the walk, a camera sees ${sufficient} landmarks or more in ${all} % of all places and directions, and in at least one direction at ${some} % of the places.`;
}

/** What is said of one place and direction. */
export function sayPlace(coverage, cell, heading, unit, right = null) {
  const at = coordinates(position(coverage, cell));
  const seen = coverage.counts[cell][heading];
  const degrees = Math.round(coverage.headings_deg[heading]);
  const [, verdict] = [
    [1, t`it works`],
    [0.5, t`it may fail`],
    [0, t`it will fail`],
  ].find(([share]) => seen >= share * coverage.sufficient);
  const text = t`At ${at} ${unit}, looking ${degrees}°: ${seen} landmarks in view; ${verdict}.`;
  if (right === null || seen < coverage.sufficient) return text;
  return `${text} ${t`A robot here, looking there, is right to about ${length(right, unit === "m")}.`}`;
}

/**
 * Where a further walk would help most: the place around which most directions fail, and the direction in which they do,
 * `{cell, degrees, position}`; null where it works everywhere. Every failing direction counts as far as its place is near.
 */
export function nextWalk(coverage) {
  const { cells, counts, headings_deg: headings, sufficient, step } = coverage;
  const failing = counts.map((seen) => headings.filter((_, i) => seen[i] < sufficient));
  if (!failing.some((found) => found.length)) return null;
  const weight = (a, b) => Math.exp(-(((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) * step ** 2) / (2 * NEAR_M ** 2));
  const lacks = cells.map((here) => cells.reduce((sum, there, i) => sum + weight(here, there) * failing[i].length, 0));
  const cell = lacks.indexOf(Math.max(...lacks));
  let [x, y] = [0, 0];
  cells.forEach((there, i) => {
    for (const degrees of failing[i]) {
      x += weight(cells[cell], there) * Math.cos((degrees * Math.PI) / 180);
      y += weight(cells[cell], there) * Math.sin((degrees * Math.PI) / 180);
    }
  });
  const degrees = ((Math.atan2(y, x) * 180) / Math.PI + 360) % 360;
  return { cell, degrees, position: position(coverage, cell) };
}

/** The camera (T_map_camera, 4 × 4) that stands in a cell and looks in a heading. */
export function cameraAt({ origin, axes, step, pitch_deg: pitch = 0, cells, headings_deg: headings }, cell, heading) {
  const up = cross(axes[0], axes[1]);
  const [angle, tilt] = [headings[heading], pitch].map((value) => (value * Math.PI) / 180);
  const level = [0, 1, 2].map((i) => Math.cos(angle) * axes[0][i] + Math.sin(angle) * axes[1][i]);
  const forward = level.map((value, i) => Math.cos(tilt) * value + Math.sin(tilt) * up[i]);
  const right = cross(level, up);
  const down = cross(forward, right);
  const at = [0, 1, 2].map((i) => origin[i] + step * (cells[cell][0] * axes[0][i] + cells[cell][1] * axes[1][i]));
  return [0, 1, 2].map((i) => [right[i], down[i], forward[i], at[i]]).concat([[0, 0, 0, 1]]);
}

/** The rose that a key moves to: the nearest one in its direction, or the next heading with shift. */
export function moved({ cells, headings_deg: headings }, { cell, heading }, key) {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
  if (key === "PageUp" || key === "PageDown")
    return cell === null
      ? null
      : { cell, heading: (heading + (key === "PageUp" ? 1 : headings.length - 1)) % headings.length };
  if (!step) return null;
  if (cell === null) return { cell: 0, heading };
  const here = cells[cell];
  const along = (one) => (one[0] - here[0]) * step[0] + (one[1] - here[1]) * step[1];
  const aside = (one) => Math.abs((one[0] - here[0]) * step[1]) + Math.abs((one[1] - here[1]) * step[0]);
  const ahead = cells.map((one, i) => [along(one) + 4 * aside(one), i]).filter(([, i]) => along(cells[i]) > 0);
  return ahead.length ? { cell: ahead.reduce((best, one) => (one[0] < best[0] ? one : best))[1], heading } : null;
}

/** The place of a cell and the direction of a heading [degrees]. */
const spotOf = (coverage, cell, heading) => [position(coverage, cell), coverage.headings_deg[heading]];

/** Where a cell is on the plane, in the map's unit. */
function position({ origin, axes, step, cells }, cell) {
  return [0, 1].map((axis) => dot(origin, axes[axis]) + step * cells[cell][axis]);
}

/** Plane → pixels, north up. */
function placement(coverage, width, height) {
  const [columns, rows] = [0, 1].map((axis) => coverage.cells.map((cell) => cell[axis]));
  const [west, east, south, north] = [Math.min(...columns), Math.max(...columns), Math.min(...rows), Math.max(...rows)];
  const pixels = Math.min(width / (east - west + 2 * MARGIN_STEPS), height / (north - south + 2 * MARGIN_STEPS));
  const toCell = (x, y) =>
    [0, 1].map((axis) => ([x, y][axis] - dot(coverage.origin, coverage.axes[axis])) / coverage.step);
  const cell = (column, row) => [
    width / 2 + pixels * (column - (west + east) / 2),
    height / 2 - pixels * (row - (south + north) / 2),
  ];
  return { pixels, cell, point: (x, y) => cell(...toCell(x, y)) };
}

function roseAt(canvas, coverage, x, y) {
  const place = placement(coverage, canvas.clientWidth, canvas.clientHeight - BAR_HEIGHT);
  const offsets = coverage.cells.map((cell) => {
    const [cx, cy] = place.cell(...cell);
    return [x - cx, cy - y];
  });
  const apart = offsets.map(([dx, dy]) => Math.hypot(dx, dy));
  const cell = apart.indexOf(Math.min(...apart));
  if (apart[cell] > place.pixels) return null;
  const width = 360 / coverage.headings_deg.length;
  const angle = (Math.atan2(offsets[cell][1], offsets[cell][0]) * 180) / Math.PI;
  return {
    cell,
    heading:
      ((Math.round(angle / width) % coverage.headings_deg.length) + coverage.headings_deg.length) %
      coverage.headings_deg.length,
  };
}

/** Whether the drawing is seen along the map's z, x to the right. */
const isLevel = ({ axes }) => axes[0][0] > 1 - LEVEL && axes[1][1] > 1 - LEVEL;

function drawCoverage(canvas, coverage, map, unit, chosen, next, failures, plan) {
  const ratio = Math.min(devicePixelRatio, 2);
  const wanted = placement(coverage, canvas.clientWidth, Infinity);
  const rows = coverage.cells.map((cell) => cell[1]);
  const tall = Math.min(MAX_HEIGHT, wanted.pixels * (Math.max(...rows) - Math.min(...rows) + 2 * MARGIN_STEPS));
  canvas.style.height = `${Math.round(tall + BAR_HEIGHT)}px`;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const token = (name) => resolvedColour(canvas, name);
  const place = placement(coverage, width, height - BAR_HEIGHT);
  if (plan) {
    const [x, y] = place.point(plan.corner[0], plan.corner[1]);
    drawFloorPlan(context, plan, [x, y], place.pixels / coverage.step, token("--muted"));
  }
  drawRoses(context, coverage, place, token("--surface"));
  drawFailures(context, coverage, place, failures, token);
  if (chosen.cell !== null) drawChosen(context, coverage, place, chosen, token("--ink"));
  drawWaypoints(context, coverage, place, map.waypoints, token);
  if (next) drawArrow(context, place.cell(...coverage.cells[next.cell]), next.degrees, place.pixels, token);
  drawBar(context, place.pixels / coverage.step, unit, [width, height], token("--ink"));
}

function wedge(context, x, y, radius, coverage, heading) {
  const half = Math.PI / coverage.headings_deg.length;
  const angle = (-coverage.headings_deg[heading] * Math.PI) / 180; // the canvas counts clockwise
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, radius, angle - half, angle + half);
  context.closePath();
}

function drawRoses(context, coverage, place, gap) {
  context.strokeStyle = gap;
  context.lineWidth = 0.5;
  coverage.cells.forEach((cell, i) => {
    const [x, y] = place.cell(...cell);
    coverage.counts[i].forEach((seen, heading) => {
      wedge(context, x, y, RADIUS * place.pixels, coverage, heading);
      context.fillStyle = colourOf(seen / coverage.sufficient);
      context.fill();
      context.stroke();
    });
  });
}

const colourOf = (share) => LEVELS.find(([least]) => share >= least)[1];

/** How many requests of the last day failed, in a sentence. */
export function sayFailures(failures) {
  if (!failures.length) return t`No request failed here in the last day, as far as this server knows.`;
  const none = failures.filter(({ reason }) => reason !== null).length;
  const lost = failures.filter(({ position }) => !position).length;
  return [
    t`Requests of the last day without a pose: ${none}, with an unsure one: ${failures.length - none}.`,
    lost < failures.length && t`The drawing glows where they came from.`,
    lost > 0 && t`Of ${lost} nobody knows where they came from.`,
  ]
    .filter(Boolean)
    .join(" ");
}

/** A glow where requests failed: the more, the stronger, but what is below stays to be seen. */
function drawFailures(context, { axes, step }, place, failures, token) {
  const placed = failures.filter(({ position }) => position);
  if (!placed.length) return;
  const { width, height } = context.canvas;
  const glow = Object.assign(document.createElement("canvas"), { width, height });
  const layer = glow.getContext("2d");
  layer.setTransform(context.getTransform());
  layer.fillStyle = token("--bad");
  layer.globalAlpha = GLOW_ALPHA;
  const reach = Math.max(GLOW_PX, (GLOW_M / step) * place.pixels);
  for (const { position } of placed) {
    const [x, y] = place.point(dot(position, axes[0]), dot(position, axes[1]));
    for (const share of [1, 0.66, 0.33]) {
      layer.beginPath();
      layer.arc(x, y, share * reach, 0, 2 * Math.PI);
      layer.fill();
    }
  }
  context.save();
  context.resetTransform();
  context.globalAlpha = MOST_GLOW;
  context.drawImage(glow, 0, 0);
  context.restore();
}

function drawChosen(context, coverage, place, { cell, heading }, ink) {
  const [x, y] = place.cell(...coverage.cells[cell]);
  wedge(context, x, y, 0.6 * place.pixels, coverage, heading);
  context.strokeStyle = ink;
  context.lineWidth = 2;
  context.stroke();
}

function drawWaypoints(context, { axes }, place, waypoints, token) {
  context.font = "600 13px system-ui, sans-serif";
  for (const { name, position } of waypoints) {
    const [x, y] = place.point(dot(position, axes[0]), dot(position, axes[1]));
    context.fillStyle = token("--ink");
    context.strokeStyle = token("--surface");
    context.lineWidth = 3;
    context.strokeText(name, x + 7, y - 5);
    context.fillText(name, x + 7, y - 5);
    context.lineWidth = 2;
    context.beginPath();
    context.rect(x - 4, y - 4, 8, 8);
    context.stroke();
    context.fill();
  }
}

/**
 * An arrow from a place, over what is drawn there.
 * @param {CanvasRenderingContext2D} context
 * @param {number[]} place
 */
function drawArrow(context, [x, y], degrees, pixels, token) {
  const angle = (-degrees * Math.PI) / 180;
  const reach = Math.max(2.5 * pixels, 40);
  /** @returns {[number, number]} */
  const at = (along, aside) => [
    x + along * Math.cos(angle) - aside * Math.sin(angle),
    y + along * Math.sin(angle) + aside * Math.cos(angle),
  ];
  for (const [colour, width] of [
    [token("--surface"), 8],
    [token("--ink"), 4],
  ]) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineCap = context.lineJoin = "round";
    context.beginPath();
    context.moveTo(...at(0, 0));
    context.lineTo(...at(reach, 0));
    context.moveTo(...at(reach - 12, -9));
    context.lineTo(...at(reach, 0));
    context.lineTo(...at(reach - 12, 9));
    context.stroke();
  }
}

function drawBar(context, pixelsPerUnit, unit, [width, height], ink) {
  const bar = BARS_M.findLast((one) => one * pixelsPerUnit <= BAR_SHARE * width) ?? BARS_M[0];
  context.strokeStyle = context.fillStyle = ink;
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(8, height - 8);
  context.lineTo(8 + bar * pixelsPerUnit, height - 8);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.fillText(`${bar} ${unit}`, 8, height - 14);
}

function legend(sufficient) {
  const item = ([least, colour]) => {
    const patch = h("span", { class: "patch" });
    patch.style.background = colour;
    return h("li", {}, patch, least ? `≥ ${Math.round(least * sufficient)}` : t`fewer`);
  };
  return fill(h("ul", { class: "coverage-legend small muted", "aria-label": t`Landmarks in view` }), LEVELS.map(item));
}

// Ways over ground that somebody has walked: a grid around the walks, A* (Hart, Nilsson and Raphael, 1968), and what to say.

const CELL_M = 0.2;
const REACH_M = 0.6; // beside a walk that may be walked, too
const ARRIVED_M = 1.2;
const STRAIGHT_RAD = 0.5; // a turn by less is none
const TURNED_RAD = 0.9; // who looks this far aside is told to turn
const DIAGONAL = Math.SQRT2;

/** What somebody is to do. */
export const Step = Object.freeze({ ARRIVED: "arrived", TURN: "turn", GO: "go" });

/** The ground around walks, lists of [x, y, …]: `{origin, columns, rows, free}`, `free` one for each cell that may be walked. */
export function groundOf(walks) {
  const points = walks.flatMap((walk) => walk.flatMap((at, i) => (i ? between(walk[i - 1], at) : [at])));
  if (!points.length) return null;
  const [low, high] = [Math.min, Math.max].map((end) =>
    [0, 1].map((k) => points.reduce((value, point) => end(value, point[k]), points[0][k])),
  );
  const origin = low.map((value) => value - REACH_M - CELL_M);
  const [columns, rows] = [0, 1].map((k) => Math.ceil((high[k] - origin[k] + REACH_M) / CELL_M) + 2);
  const free = new Uint8Array(columns * rows);
  const reach = Math.ceil(REACH_M / CELL_M);
  for (const point of points) {
    const [column, row] = cellOf({ origin }, point);
    for (let j = row - reach; j <= row + reach; j++)
      for (let i = column - reach; i <= column + reach; i++)
        if (Math.hypot(i - column, j - row) <= reach) free[j * columns + i] = 1;
  }
  return { origin, columns, rows, free };
}

/** The shortest way between two places as corners [x, y], both ends among them; null where no walk joins them. */
export function wayBetween(ground, from, to) {
  const [start, goal] = [nearestFree(ground, from), nearestFree(ground, to)];
  const cells = search(ground, start, goal);
  if (!cells) return null;
  const middles = cells.map((cell) => placeOf(ground, cell));
  return [from.slice(0, 2), ...pulled(ground, middles), to.slice(0, 2)];
}

/** The length of a way [m]. */
export const lengthOf = (way) =>
  way.slice(1).reduce((sum, [x, y], i) => sum + Math.hypot(x - way[i][0], y - way[i][1]), 0);

/**
 * What to do at the beginning of a way, looking in a direction [rad]: `{step, metres, turn, bearing, left}`; `turn` is where
 * to turn after so many metres, -1 to the right, 0 not at all, 1 to the left; `bearing` [rad] how far to the left the way is.
 */
export function guidance(way, direction) {
  const left = lengthOf(way);
  if (left < ARRIVED_M) return { step: Step.ARRIVED, metres: 0, turn: 0, bearing: 0, left };
  const legs = way.slice(1).map(([x, y], i) => [x - way[i][0], y - way[i][1]]);
  const long = legs.filter(([x, y]) => Math.hypot(x, y) > CELL_M);
  const angles = long.map(([x, y]) => Math.atan2(y, x));
  const bearing = wrapped(angles[0] - direction);
  let metres = Math.hypot(...long[0]);
  let turn = 0;
  for (let i = 1; i < long.length && !turn; i++) {
    const by = wrapped(angles[i] - angles[i - 1]);
    if (Math.abs(by) > STRAIGHT_RAD) turn = Math.sign(by);
    else metres += Math.hypot(...long[i]);
  }
  return { step: Math.abs(bearing) > TURNED_RAD ? Step.TURN : Step.GO, metres, turn, bearing, left };
}

const wrapped = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

/** Places from one to another, no more than half a cell apart, without the first. */
function between(from, to) {
  const count = Math.max(1, Math.ceil(Math.hypot(to[0] - from[0], to[1] - from[1]) / (CELL_M / 2)));
  return Array.from({ length: count }, (_, i) => [0, 1].map((k) => from[k] + ((i + 1) / count) * (to[k] - from[k])));
}

const cellOf = ({ origin }, point) => [0, 1].map((k) => Math.floor((point[k] - origin[k]) / CELL_M));
const placeOf = ({ origin, columns }, cell) => [
  origin[0] + ((cell % columns) + 0.5) * CELL_M,
  origin[1] + (Math.floor(cell / columns) + 0.5) * CELL_M,
];

function nearestFree(ground, point) {
  const [column, row] = cellOf(ground, point);
  let [best, least] = [-1, Infinity];
  for (let cell = 0; cell < ground.free.length; cell++) {
    if (!ground.free[cell]) continue;
    const apart = Math.hypot((cell % ground.columns) - column, Math.floor(cell / ground.columns) - row);
    if (apart < least) [best, least] = [cell, apart];
  }
  return best;
}

/** A* over the eight neighbours; cells from start to goal, or null. */
function search({ columns, free }, start, goal) {
  const cost = new Float64Array(free.length).fill(Infinity);
  const before = new Int32Array(free.length).fill(-1);
  const left = (cell) =>
    Math.hypot((cell % columns) - (goal % columns), Math.floor(cell / columns) - Math.floor(goal / columns));
  const open = new Heap();
  cost[start] = 0;
  open.push(left(start), start);
  while (open.size) {
    const cell = open.pop();
    if (cell === goal) break;
    for (const [step, length] of neighbours(columns)) {
      const next = cell + step;
      if (!free[next] || cost[cell] + length >= cost[next]) continue;
      cost[next] = cost[cell] + length;
      before[next] = cell;
      open.push(cost[next] + left(next), next);
    }
  }
  if (!Number.isFinite(cost[goal])) return null;
  const cells = [goal];
  while (cells[0] !== start) cells.unshift(before[cells[0]]);
  return cells;
}

const neighbours = (columns) => [
  [1, 1],
  [-1, 1],
  [columns, 1],
  [-columns, 1],
  [columns + 1, DIAGONAL],
  [columns - 1, DIAGONAL],
  [1 - columns, DIAGONAL],
  [-columns - 1, DIAGONAL],
];

/** The corners that are left of a way if it is pulled tight over free ground. */
function pulled(ground, places) {
  const corners = [places[0]];
  for (let i = 0; i < places.length - 1; ) {
    let next = places.length - 1;
    while (next > i + 1 && !isFree(ground, places[i], places[next])) next--;
    corners.push(places[next]);
    i = next;
  }
  return corners;
}

const isFree = (ground, from, to) =>
  between(from, to).every((point) => {
    const [column, row] = cellOf(ground, point);
    return ground.free[row * ground.columns + column] === 1;
  });

/** A binary heap of cells by their cost, the least first. */
class Heap {
  constructor() {
    this.items = [];
  }

  get size() {
    return this.items.length;
  }

  push(cost, cell) {
    const { items } = this;
    let at = items.push([cost, cell]) - 1;
    for (let above = (at - 1) >> 1; at > 0 && items[above][0] > items[at][0]; at = above, above = (at - 1) >> 1)
      [items[at], items[above]] = [items[above], items[at]];
  }

  pop() {
    const { items } = this;
    const [[, cell], last] = [items[0], items.pop()];
    if (items.length) {
      items[0] = last;
      for (let at = 0; ; ) {
        let least = at;
        for (const below of [2 * at + 1, 2 * at + 2])
          if (below < items.length && items[below][0] < items[least][0]) least = below;
        if (least === at) break;
        [items[at], items[least]] = [items[least], items[at]];
        at = least;
      }
    }
    return cell;
  }
}

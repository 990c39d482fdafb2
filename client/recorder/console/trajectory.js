// A trajectory (Table 6) → poses to play.

const NEEDED = ["timestamp", "x", "y", "z", "hx", "hy", "hz"];
const MAX_SAID = 40;

/**
 * The rows of a trajectory CSV: `{time, position, T}`, T 4 × 4 (camera → map), by time.
 * @throws {Error} what is wrong with the file.
 */
export function readTrajectory(text) {
  const [head, ...lines] = text.trim().split(/\r?\n/);
  const names = head.split(",").map((name) => name.trim());
  const missing = NEEDED.filter((name) => !names.includes(name));
  if (missing.length) throw new Error(`This is not a trajectory: it has no column ${missing.join(", ")}.`);
  const rows = lines.filter(Boolean).map((line, i) => {
    const values = line.split(",");
    const row = Object.fromEntries(NEEDED.map((name) => [name, Number(values[names.indexOf(name)])]));
    if (!Object.values(row).every(Number.isFinite))
      throw new Error(`Line ${i + 2} is not made of numbers: ${line.slice(0, MAX_SAID)}`);
    return row;
  });
  if (!rows.length) throw new Error("The trajectory has no rows.");
  return rows.sort((a, b) => a.timestamp - b.timestamp).map(pose);
}

function pose({ timestamp, x, y, z, hx, hy, hz }) {
  return { time: timestamp, position: [x, y, z], T: upright([x, y, z], [hx, hy, hz]) };
}

/** The camera that looks along a heading without roll: x right, y down, z forward. */
function upright(position, heading) {
  const size = Math.hypot(...heading) || 1;
  const [a, b, c] = heading.map((value) => value / size);
  const level = Math.hypot(a, b) || 1;
  const right = [b / level, -a / level, 0];
  const down = [c * (a / level), c * (b / level), -level];
  return [0, 1, 2].map((i) => [right[i], down[i], [a, b, c][i], position[i]]).concat([[0, 0, 0, 1]]);
}

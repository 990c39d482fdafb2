// A trajectory (Table 6) → poses to play.

import { rotationOf } from "../../js/poses.js";
import { t } from "../shared/text.js";

const NEEDED = ["timestamp", "x", "y", "z", "hx", "hy", "hz"];
const TURNED = ["qx", "qy", "qz", "qw"];
const MAX_SHOWN = 40;

/**
 * The rows of a trajectory CSV: `{time, position, T}`, T 4 × 4 (camera → map), by time. Where it has quaternions, or the
 * roll in radians, the camera rolls.
 * @throws {Error} what is wrong with the file.
 */
export function readTrajectory(text) {
  const [head, ...lines] = text.trim().split(/\r?\n/);
  const names = head.split(",").map((name) => name.trim());
  const missing = NEEDED.filter((name) => !names.includes(name));
  if (missing.length) throw new Error(t`This is not a trajectory: it has no column ${missing.join(", ")}.`);
  const rows = lines.filter(Boolean).map((line, i) => {
    const values = line.split(",");
    const figure = (name) => (values[names.indexOf(name)] ?? "").trim();
    const row = Object.fromEntries(NEEDED.map((name) => [name, figure(name) === "" ? NaN : Number(figure(name))]));
    if (!Object.values(row).every(Number.isFinite))
      throw new Error(t`Line ${i + 2} contains something other than numbers: ${line.slice(0, MAX_SHOWN)}`);
    const quaternion = TURNED.map((name) => parseFloat(figure(name)));
    return { ...row, roll: parseFloat(figure("roll")) || 0, quaternion };
  });
  if (!rows.length) throw new Error(t`The trajectory has no rows.`);
  return rows.sort((a, b) => a.timestamp - b.timestamp).map(pose);
}

function pose({ timestamp, x, y, z, hx, hy, hz, roll, quaternion }) {
  const position = [x, y, z];
  const R = quaternion.every(Number.isFinite) ? rotationOf(quaternion) : ofHeading([hx, hy, hz], roll);
  const T = R.map((row, i) => [...row, position[i]]).concat([[0, 0, 0, 1]]);
  return { time: timestamp, position, T };
}

/** R_map_camera of a heading and a roll about it against the upright camera: x right, y down, z forward. */
function ofHeading(heading, roll) {
  const size = Math.hypot(...heading) || 1;
  const [a, b, c] = heading.map((value) => value / size);
  const level = Math.hypot(a, b) || 1;
  const right = [b / level, -a / level, 0];
  const down = [c * (a / level), c * (b / level), -level];
  const [cos, sin] = [Math.cos(roll), Math.sin(roll)];
  return [0, 1, 2].map((i) => [cos * right[i] + sin * down[i], cos * down[i] - sin * right[i], [a, b, c][i]]);
}
